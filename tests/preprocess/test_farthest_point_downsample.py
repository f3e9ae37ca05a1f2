"""Farthest points against a plain loop."""

import oracles
import pytest
import torch
from determinism import THREADS, same_bits, threads
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refuses

import torchreg as tr
from torchreg.geometry.morton import morton_order


def cloud(rows, seed=0, dtype=torch.float64):
    points = torch.rand(rows, 3, generator=torch.Generator().manual_seed(seed), dtype=dtype)
    return tr.Clouds(points=points, colors=1 - points)


def as_set(points):
    return sorted(points.tolist())


@settings(max_examples=40)
@given(st.integers(0, 2**31), st.integers(1, 30), st.integers(1, 30))
def test_the_points_are_those_of_a_plain_loop(seed, rows, count):
    one = cloud(rows, seed)
    kept = tr.farthest_point_downsample(one, count)
    expected = oracles.farthest_points(one.points, count) if count < rows else range(rows)
    assert as_set(kept.points) == as_set(one.points[list(expected)])
    assert torch.equal(kept.colors, 1 - kept.points)


def test_ties_go_to_the_lower_row():
    corners = torch.tensor([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], dtype=torch.float64)
    for order in ([0, 1, 2, 3], [3, 1, 0, 2], [2, 3, 1, 0]):
        one = tr.Clouds(points=corners[order])
        for count in (1, 2, 3):
            kept = tr.farthest_point_downsample(one, count)
            assert as_set(kept.points) == as_set(one.points[oracles.farthest_points(one.points, count)])


def test_points_come_in_morton_order_and_cover_the_cloud():
    one = cloud(1000)
    kept = tr.farthest_point_downsample(one, 100)
    assert torch.equal(morton_order(kept.points, kept.offsets), torch.arange(100))
    reach = torch.cdist(one.points, kept.points).min(dim=1).values.max()
    at_random = tr.random_downsample(one, 100)
    assert reach < 0.8 * torch.cdist(one.points, at_random.points).min(dim=1).values.max()


def test_a_batch_equals_the_loop_over_its_clouds():
    made = [cloud(rows, rows, torch.float32) for rows in (100, 0, 4, 57)]
    alone = [tr.farthest_point_downsample(one, 20) for one in made]
    assert same_bits(tr.farthest_point_downsample(tr.Clouds.pack(made), 20), tr.Clouds.pack(alone))


def test_the_number_of_threads_changes_nothing():
    one = cloud(100_000, dtype=torch.float32)
    kept = []
    for number in THREADS:
        with threads(number):
            kept.append(tr.farthest_point_downsample(one, 40))
    assert all(same_bits(other, kept[0]) for other in kept)


@pytest.mark.parametrize("count", [0, 1.0])
def test_a_count_that_is_none_is_refused(count):
    with refuses("count", "an integer"):
        tr.farthest_point_downsample(cloud(5), count)
