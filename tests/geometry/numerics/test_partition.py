from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from torchreg.geometry.numerics.partition import partition

COSTS = st.lists(st.integers(0, 50), max_size=30)


def cost_of(costs, padded):
    return len(costs) * max(costs) if padded else sum(costs)


@given(COSTS, st.integers(1, 100), st.booleans())
def test_runs_cover_all_items_in_order_and_fit(costs, budget, padded):
    runs = partition(costs, budget, padded=padded)
    assert [place for run in runs for place in range(run.start, run.stop)] == list(range(len(costs)))
    for run in runs:
        assert cost_of(costs[run], padded) <= budget or run.stop - run.start == 1


@given(COSTS, st.integers(1, 100), st.booleans())
def test_no_run_could_take_the_next_item(costs, budget, padded):
    runs = partition(costs, budget, padded=padded)
    for run, following in pairwise(runs):
        assert cost_of(costs[run.start : following.start + 1], padded) > budget
