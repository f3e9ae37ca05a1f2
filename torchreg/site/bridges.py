"""Links without which a graph of scans would fall apart.

Tarjan, A note on finding the bridges of a graph, Information Processing Letters 2(6), 1974,
doi:10.1016/0020-0190(74)90003-9.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple


class Bridge(NamedTuple):
    """A link that alone holds together what is on its two sides."""

    number: int
    """Of the link, in the order given."""

    smaller: frozenset[int]
    """The scans on the side with fewer; of equal sides the one without the lowest number."""


def bridges(links: Sequence[tuple[int, int]], count: int) -> list[Bridge]:
    """The bridges among undirected links of ``count`` nodes numbered from 0; two links of one pair are none."""
    around: list[list[tuple[int, int]]] = [[] for _ in range(count)]
    for number, (one, other) in enumerate(links):
        around[one].append((other, number))
        around[other].append((one, number))
    found = []
    place = [-1] * count  # in the order of the walk
    lowest = [0] * count  # the first place that the nodes below reach without the link they were entered by
    order: list[int] = []
    size = [1] * count
    for root in range(count):
        if place[root] >= 0:
            continue
        first, stack = len(order), [(root, -1, iter(around[root]))]
        place[root] = lowest[root] = first
        order.append(root)
        cuts = []
        while stack:
            node, entered, rest = stack[-1]
            step = next(rest, None)
            if step is None:
                stack.pop()
                if stack:
                    above = stack[-1][0]
                    lowest[above] = min(lowest[above], lowest[node])
                    size[above] += size[node]
                    if lowest[node] == place[node]:
                        cuts.append((entered, node))
            elif step[1] != entered and place[step[0]] < 0:
                place[step[0]] = lowest[step[0]] = len(order)
                order.append(step[0])
                stack.append((step[0], step[1], iter(around[step[0]])))
            elif step[1] != entered:
                lowest[node] = min(lowest[node], place[step[0]])
        together = set(order[first:])
        for number, node in cuts:
            below = set(order[place[node] : place[node] + size[node]])
            beyond = together - below
            smaller = min((below, beyond), key=lambda side: (len(side), -min(side)))
            found.append(Bridge(number, frozenset(smaller)))
    return found
