"""torchreg: ``register_site``, and the plain tree that it has to be better than."""

from __future__ import annotations

from itertools import combinations

import torchreg as tr
from torchreg.benchmark.site.method import SiteAnswer, SiteMethod, SiteTask, along_tree

_ACCEPTED = 0.5  # probability


def _site(task: SiteTask) -> SiteAnswer:
    result = tr.register_site(list(task.scans), seed=task.seed)
    return SiteAnswer(T_world_scan=result.T_world_scan, group=result.group, pairs_tried=len(result.pairs))


def _tree(task: SiteTask) -> SiteAnswer:
    count = len(task.scans)
    accepted = []
    for source in range(count - 1):
        targets = range(source + 1, count)
        one = tr.Clouds.pack([task.scans[source]] * len(targets))
        result = tr.register(one, tr.Clouds.pack([task.scans[target] for target in targets]), seed=task.seed)
        assert result.probability is not None
        for k, target in enumerate(targets):
            probability = float(result.probability[k])
            if probability >= _ACCEPTED:
                accepted.append((probability, source, target, result.T_target_source[k]))
    accepted.sort(key=lambda link: (-link[0], link[1], link[2]))
    answer = along_tree(count, [link[1:] for link in accepted])
    pairs = sum(1 for _ in combinations(range(count), 2))
    return SiteAnswer(T_world_scan=answer.T_world_scan, group=answer.group, pairs_tried=pairs)


SITE_METHODS = (
    SiteMethod(
        name="site",
        title="torchreg site",
        statement="`tr.register_site`, defaults.",
        run=_site,
    ),
    SiteMethod(
        name="tree",
        title="a tree of pairs",
        statement="All pairs by `tr.register`, defaults; of those it holds right with a probability of at least "
        f"{_ACCEPTED:g}, the tree of the highest, and nothing else.",
        run=_tree,
    ),
)
