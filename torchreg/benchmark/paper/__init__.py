"""The paper's five experiments with its settings and initial poses, on simulated and on real scans.

``settings`` holds its Tables 1 to 4 and ``printed`` its Tables 5 to 9; ``places`` lists the scans that stand for its
mall and its road, ``methods`` what is compared, ``measure`` measures the rows, ``tables`` and ``document`` write them,
``charts``, ``clouds_figure`` and ``pictures`` draw them, and ``study`` puts these together.
"""
