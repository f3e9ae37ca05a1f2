"""The search in torch alone is exact for any extent, radius and budget of memory, and waits for no value."""

import pytest
import torch
from determinism import same_bits
from host_transfers import HostTransfers
from neighborhoods.oracle import all_pairs
from problems import random_points

from torchreg.neighborhoods.cells import _nearest_in_cells, k_smallest, make_grid, search_cells
from torchreg.neighborhoods.distances import squared_distances


def with_outlier(far):
    points = random_points(200)
    points[17] = far
    return points


def dense_corner():
    points = random_points(300)
    points[::2] *= 1e-3
    return points


CASES = {
    "radius beyond the extent": (random_points(200), 1e6),
    "infinite squared radius": (random_points(200), 1e25),
    "radius far below the extent": (random_points(200), 1e-7),
    "more cells than numbers for them": (with_outlier(1e15), 1e-3),
    "an outlier within the radius": (with_outlier(1e5), 1e7),
    "coordinates as large as they may be": (random_points(200) * 4e18, 1e18),
    "a national grid in float32": (random_points(200) * 50 + 5e6, 10.0),
    "a national grid in float64": (random_points(200, dtype=torch.float64) * 50 + 5e6, 10.0),
    "distances that underflow": (random_points(100) * 1e-22, 1e-21),
    "a dense corner": (dense_corner(), 0.5),
    "half of them duplicates": (torch.cat([random_points(100), torch.full((100, 3), 0.5)]), 0.4),
    "all duplicates": (torch.full((80, 3), 0.1), 0.4),
    "a line": (random_points(200) * torch.tensor([0.0, 1.0, 0.0]), 0.05),
    "cell walls": (torch.cartesian_prod(*[torch.arange(6.0)] * 3), 2.0),
    "one point": (random_points(1), 1.0),
}


@pytest.mark.parametrize("max_neighbors", [1, 7, 250])
@pytest.mark.parametrize(("points", "radius"), CASES.values(), ids=CASES)
def test_it_finds_what_all_pairs_find(points, radius, max_neighbors):
    rows = len(points)
    limit = torch.tensor(radius**2, dtype=points.dtype).item()
    found = search_cells(points, [(0, rows)], [limit], max_neighbors)
    assert same_bits(found, all_pairs(points, torch.tensor([0, rows]), [limit], max_neighbors))


def test_clouds_of_very_different_scale_share_a_batch():
    points = torch.cat([random_points(100) * 1e-6, random_points(80) * 1e9, random_points(60)])
    spans, offsets = [(0, 100), (100, 180), (180, 180), (180, 240)], torch.tensor([0, 100, 180, 180, 240])
    limits = torch.tensor([1e-13, 1e17, 1.0, 9.0]).tolist()
    assert same_bits(search_cells(points, spans, limits, 20), all_pairs(points, offsets, limits, 20))


@pytest.mark.parametrize("max_bytes", [1, 3_000, 40_000, 2**20])
def test_the_budget_of_memory_does_not_show(max_bytes):
    points = torch.cat([dense_corner()[:120], torch.full((15, 3), 0.5)])
    whole = search_cells(points, [(0, 135)], [0.25], 20)
    assert same_bits(search_cells(points, [(0, 135)], [0.25], 20, max_bytes), whole)


def test_far_cells_of_one_cloud_are_not_taken_for_those_of_another():
    points = torch.tensor([[0.0, 0, 0], [0, 0, 1e15], [0, 0, 0], [0, 0, 1e15]])
    index, valid, _ = search_cells(points, [(0, 2), (2, 3), (3, 4)], [1e-6] * 3, 2)
    assert valid.sum(dim=1).tolist() == [1, 1, 1, 1]
    assert index[:, 0].tolist() == [0, 1, 2, 3]


FINE_LINE = torch.linspace(0, 0.4, 401)[:, None]


@pytest.mark.parametrize(
    "points",
    [random_points(2000), *(FINE_LINE * axis for axis in torch.eye(3))],
    ids=["everywhere", "along x", "along y", "along z"],
)
def test_the_cells_around_a_cell_hold_all_within_the_radius_and_little_else(points):
    radius, rows = 0.1, len(points)
    grid = make_grid(points, torch.zeros(rows, dtype=torch.int64), torch.tensor([radius**2]))
    assert sorted(grid.order.tolist()) == list(range(rows))
    for row in range(0, rows, 19):
        begin, length = grid.begin[grid.cell[row]].tolist(), grid.length[grid.cell[row]].tolist()
        around = torch.cat([grid.order[low : low + count] for low, count in zip(begin, length, strict=True)])
        assert len(set(around.tolist())) == len(around)
        distance = (points - points[row]).abs().amax(dim=1)
        assert set((distance < radius).nonzero().view(-1).tolist()) <= set(around.tolist())
        assert (distance[around] < 2.001 * radius).all()


def test_the_inner_kernel_waits_for_no_value():
    points = random_points(500)
    grid = make_grid(points, torch.zeros(500, dtype=torch.int64), torch.tensor([0.04]))
    axes, rows = points.t().contiguous(), torch.arange(100)
    with HostTransfers() as watch:
        _nearest_in_cells(axes, grid, rows, 500, 10, 20_000)
    assert watch.operations
    assert watch.transfers == []


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_k_smallest_settles_ties_by_index(dtype):
    generator = torch.Generator().manual_seed(0)
    values = torch.randint(0, 5, (200, 30), generator=generator).to(dtype)
    values[values == 4] = torch.inf
    index = torch.stack([torch.randperm(90, generator=generator)[:30] for _ in range(200)])
    smallest, rows = k_smallest(values, index, 9)
    for row in range(200):
        pairs = sorted(zip(values[row].tolist(), index[row].tolist(), strict=True))[:9]
        assert list(zip(smallest[row].tolist(), rows[row].tolist(), strict=True)) == pairs


def test_squared_distances_round_after_every_operation():
    points = random_points(300)
    candidates = torch.randint(0, 300, (300, 7), generator=torch.Generator().manual_seed(1))
    squares = squared_distances(points.t().contiguous(), torch.arange(300), candidates)
    p, q = points.numpy()[:, None], points.numpy()[candidates.numpy()]
    x, y, z = (q[..., axis] - p[..., axis] for axis in range(3))  # NumPy rounds each product and sum to float32
    assert same_bits(squares, torch.from_numpy((x * x + y * y) + z * z))
