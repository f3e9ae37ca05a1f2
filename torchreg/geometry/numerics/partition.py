"""Items of known cost cut into runs that fit a budget, such as the pairs of a batch into slices."""

from __future__ import annotations

from collections.abc import Sequence


def partition(costs: Sequence[int], budget: int, *, padded: bool = False) -> list[slice]:
    """Cut items, in order, into runs that cost at most ``budget``; an item that alone costs more is a run by itself.

    Where ``padded``, the items of a run are filled up to the costliest, so that each costs as much as that one. Returns
    slices that cover all items, each of one item at least.
    """
    runs: list[slice] = []
    begin = total = widest = 0
    for place, cost in enumerate(costs):
        wider = max(widest, cost)
        grown = (place - begin + 1) * wider if padded else total + cost
        if place > begin and grown > budget:
            runs.append(slice(begin, place))
            begin, total, wider = place, 0, cost
        total, widest = total + cost, wider
    return [*runs, slice(begin, len(costs))] if len(costs) > 0 else runs
