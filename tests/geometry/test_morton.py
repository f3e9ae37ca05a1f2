"""Morton order is a permutation within every cloud, follows the interleaved bits, and keeps near points near."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from problems import random_points

from torchreg.geometry.morton import morton_order, occupied_cells
from torchreg.types.packing import offsets_of, spans


@given(st.lists(st.integers(0, 40), min_size=1, max_size=5), st.integers(0, 2**31))
def test_it_is_a_permutation_within_every_cloud(lengths, seed):
    offsets = offsets_of(lengths)
    order = morton_order(random_points(sum(lengths), seed), offsets)
    assert order.dtype == torch.int64
    for begin, end in spans(offsets):
        assert sorted(order[begin:end].tolist()) == list(range(begin, end))


@given(st.lists(st.integers(0, 40), min_size=1, max_size=5), st.integers(0, 2**31))
def test_a_batch_equals_the_loop_over_its_clouds(lengths, seed):
    offsets = offsets_of(lengths)
    points = random_points(sum(lengths), seed)
    alone = [morton_order(points[begin:end], torch.tensor([0, end - begin])) + begin for begin, end in spans(offsets)]
    assert torch.equal(morton_order(points, offsets), torch.cat(alone))


@given(st.integers(0, 2**31))
def test_it_sorts_by_the_interleaved_bits(seed):
    generator = torch.Generator().manual_seed(seed)
    grid = torch.randint(0, 2**21, (50, 3), generator=generator)
    grid[:2] = torch.tensor([[0, 0, 0], [2**21 - 1] * 3])  # the bounding cube is then the whole grid

    def code(cell):
        return sum(((value >> bit) & 1) << (3 * bit + axis) for axis, value in enumerate(cell) for bit in range(21))

    codes = [code(cell) for cell in grid.tolist()]
    order = morton_order(grid.double(), torch.tensor([0, 50]))
    assert order.tolist() == sorted(range(50), key=codes.__getitem__)


def test_points_close_in_order_are_close_in_space():
    points = random_points(5000)
    order = morton_order(points, torch.tensor([0, 5000]))
    step = points[order].diff(dim=0).norm(dim=1).mean()
    assert step < 2.5 / 5000 ** (1 / 3)  # the spacing of a lattice of as many points is 1 / P^(1/3)
    assert step < 0.2 * points.diff(dim=0).norm(dim=1).mean()


def test_points_of_equal_code_keep_their_order():
    points = random_points(20)[:, None].repeat(1, 3, 1).reshape(60, 3)
    order = morton_order(points, torch.tensor([0, 60])).view(20, 3)
    assert torch.equal(order, order[:, :1] + torch.arange(3))


def test_it_does_not_depend_on_place_and_scale():
    points = random_points(300, dtype=torch.float64).mul(1024).floor()  # steps that shift and scale exactly
    offsets = torch.tensor([0, 300])
    order = morton_order(points, offsets)
    assert torch.equal(morton_order(points * 4 + 2**20, offsets), order)
    assert not torch.equal(order, torch.arange(300))


@pytest.mark.parametrize(
    "points",
    [
        torch.zeros(0, 3),
        torch.full((1, 3), 7.0),
        torch.full((4, 3), -3.0),
        torch.tensor([[0.0, 0, 0], [0, 0, 5e-45], [0, 0, 1e-44]]),
        torch.tensor([[-3e38, 0, 0], [0.0, 0, 0], [3e38, 0, 0]]),
    ],
    ids=["none", "one", "duplicates", "subnormal extent", "huge extent"],
)
def test_degenerate_clouds_keep_their_order(points):
    offsets = torch.tensor([0, len(points)])
    assert torch.equal(morton_order(points, offsets), torch.arange(len(points)))


def test_points_that_are_not_finite_still_give_a_permutation():
    points = random_points(10)
    points[3, 1], points[7, 0] = torch.nan, torch.inf
    assert sorted(morton_order(points, torch.tensor([0, 10])).tolist()) == list(range(10))


@pytest.mark.parametrize(
    ("points", "name"),
    [
        (torch.zeros(4, 2), "points"),
        (torch.zeros(4, 3, dtype=torch.int64), "points"),
        (torch.zeros(5, 3), "offsets"),
    ],
)
def test_what_does_not_fit_is_refused(points, name):
    with pytest.raises(ValueError, match=f"^{name}: expected "):
        morton_order(points, torch.tensor([0, 4]))


@given(st.integers(1, 60), st.integers(0, 2**31), st.sampled_from([0.0, 1.0, -3e5]))
def test_occupied_cells_are_those_of_the_halved_bounding_cube(count, seed, shift):
    points = random_points(count, seed, torch.float64) + shift
    points[count // 2 :, 2] = points[0, 2]
    low = points.amin(dim=0)
    extent = float((points - low).amax()) or 1.0
    finest = ((points - low) / extent * (2**21 - 1)).long()
    expected = [len({tuple(cell) for cell in (finest >> (21 - n)).tolist()}) for n in range(22)]
    assert occupied_cells(points) == expected


def test_occupied_cells_grow_from_one_to_the_number_of_places():
    points = random_points(40).repeat(3, 1)
    counts = occupied_cells(points)
    assert counts[0] == 1
    assert counts == sorted(counts)
    assert counts[-1] == 40
    assert occupied_cells(points[:1]) == [1] * 22
