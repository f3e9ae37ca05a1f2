"""The paper's five experiments with its settings and initial poses, on simulated and on real scans.

``settings`` holds its Tables 1 to 4 and ``printed`` its Tables 5 to 9; ``places`` says which scans stand for its mall
and its road, ``methods`` what is compared, ``run`` and ``times`` measure, ``rows`` keeps what was measured, and
``tables``, ``charts`` and ``clouds_figure`` show it.
"""
