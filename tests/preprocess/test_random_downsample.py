"""Exactly so many points, drawn from a generator and from nothing else."""

import pytest
import torch
from determinism import THREADS, same_bits, threads
from hypothesis import given
from hypothesis import strategies as st
from refusals import refuses

import torchreg as tr
from torchreg.geometry.morton import morton_order


def cloud(rows, seed=0):
    generator = torch.Generator().manual_seed(seed)
    points = torch.rand(rows, 3, generator=generator)
    return tr.Clouds(points=points, colors=1 - points)


def draw(seed):
    return torch.Generator().manual_seed(seed)


@given(st.lists(st.integers(0, 30), min_size=1, max_size=5), st.integers(1, 20), st.integers(0, 2**31))
def test_exactly_so_many_points_stay_each_at_most_once(lengths, count, seed):
    clouds = tr.Clouds.pack([cloud(rows, b) for b, rows in enumerate(lengths)])
    kept = tr.random_downsample(clouds, count, generator=draw(seed))
    assert kept.lengths == [min(rows, count) for rows in lengths]
    assert torch.equal(kept.colors, 1 - kept.points)
    for before, after in zip(clouds.unpack(), kept.unpack(), strict=True):
        rows = {tuple(row) for row in before.points.tolist()}
        chosen = [tuple(row) for row in after.points.tolist()]
        assert len(set(chosen)) == len(chosen)
        assert set(chosen) <= rows


def test_points_come_in_morton_order():
    kept = tr.random_downsample(cloud(500), 100)
    assert torch.equal(morton_order(kept.points, kept.offsets), torch.arange(100))


def test_every_point_is_as_likely():
    one = cloud(20)
    generator = draw(0)
    taken = torch.zeros(20)
    for _ in range(600):
        kept = tr.random_downsample(one, 5, generator=generator)
        taken += (one.points[:, None] == kept.points[None]).all(dim=2).any(dim=1)
    # 600 draws at 1/4: mean 150, standard deviation 10.6
    assert taken.min() > 100
    assert taken.max() < 200


def test_the_same_generator_state_gives_the_same_points():
    one = cloud(100)
    assert same_bits(tr.random_downsample(one, 10, generator=draw(7)), tr.random_downsample(one, 10, generator=draw(7)))
    assert not same_bits(
        tr.random_downsample(one, 10, generator=draw(7)), tr.random_downsample(one, 10, generator=draw(8))
    )
    generator = draw(7)
    first, second = (tr.random_downsample(one, 10, generator=generator) for _ in range(2))
    assert not same_bits(first, second)


def test_the_global_seed_is_left_alone():
    before = torch.get_rng_state()
    without = tr.random_downsample(cloud(100), 10)
    assert torch.equal(torch.get_rng_state(), before)
    torch.manual_seed(torch.initial_seed() + 1)
    assert same_bits(tr.random_downsample(cloud(100), 10), without)
    torch.set_rng_state(before)


def test_a_batch_equals_the_loop_over_its_clouds():
    made = [cloud(rows, rows) for rows in (100, 3, 0, 50)]
    alone = [tr.random_downsample(one, 20, generator=draw(5)) for one in made]
    assert same_bits(tr.random_downsample(tr.Clouds.pack(made), 20, generator=draw(5)), tr.Clouds.pack(alone))


def test_the_number_of_threads_changes_nothing():
    one = cloud(100_000)
    kept = []
    for number in THREADS:
        with threads(number):
            kept.append(tr.random_downsample(one, 40_000, generator=draw(3)))
    assert all(same_bits(other, kept[0]) for other in kept)


@pytest.mark.parametrize("count", [0, -1, 2.0, True])
def test_a_count_that_is_none_is_refused(count):
    with refuses("count", "an integer"):
        tr.random_downsample(cloud(5), count)
