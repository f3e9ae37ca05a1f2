"""How far the links of a site can be trusted, by how often they contradict each other.

The probabilities of links come from pairs of many scenes. In a scene of repeated panels, shelves or bays they promise
too much: most links that seem sure are wrong then. A tree through the scans uses some of the links; all others, between
scans that it joins, are tests of it. As long as most of them pass, the vote of links deals with the others. Where most
fail, the same number is taken from the log-odds of all links of the site: the likeliest one, given how likely each link
says it is to pass, and what passed and failed.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from torchreg.site.links import Link
from torchreg.site.placement import Placement

_SURE = 0.5  # probability of links that are tests
_DEVIATION = 2.0  # of the number, beforehand
_STEP, _MOST = 0.25, 8.0  # of the numbers that are tried


def doubt(links: Sequence[Link], placement: Placement) -> float:
    """The number, 0 or more, to be taken from the log-odds of all links; they are those that were placed."""
    tests = [*_tests(links, placement)]
    if 2 * sum(right for _, right in tests) >= len(tests):
        return 0.0
    chance = torch.tensor([link.probability for link, _ in tests], dtype=torch.float64).logit(eps=1e-9)
    passed = torch.tensor([right for _, right in tests])
    taken = torch.arange(0.0, _MOST, _STEP, dtype=torch.float64)
    less = chance - taken[:, None]  # (numbers, tests)
    likelihood = torch.nn.functional.logsigmoid(torch.where(passed, less, -less)).sum(dim=1)
    return float(taken[(likelihood - 0.5 * (taken / _DEVIATION).square()).argmax()])


def _tests(links: Sequence[Link], placement: Placement) -> list[tuple[Link, bool]]:
    """The sure links that no tree through the scans needs, and whether each agrees with the poses."""
    tests: list[tuple[Link, bool]] = []
    group = placement.group.tolist()
    used = placement.used.tolist()
    sizes = torch.bincount(placement.group[placement.group >= 0]).tolist()
    for name, size in enumerate(sizes):
        inside = [
            row
            for row, link in enumerate(links)
            if link.probability >= _SURE and group[link.source] == name == group[link.target]
        ]
        agreeing = sorted((row for row in inside if used[row]), key=lambda row: (-links[row].log_odds, row))
        tests += [(links[row], True) for row in agreeing[size - 1 :]]
        tests += [(links[row], False) for row in inside if not used[row]]
    return tests
