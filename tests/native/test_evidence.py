"""What poses show on clouds has the bits that torch computes, kernel by kernel and in all, on any number of threads."""

from dataclasses import replace

import pytest
import torch
from determinism import same_bits, threads
from problems import random_transform, room_pair

import torchreg as tr
from torchreg.native import native_kernels, native_library
from torchreg.verification.evidence import evidence, overlap
from torchreg.verification.free_space import RangeImages, visible_counts
from torchreg.verification.information import weakest_motions
from torchreg.verification.partners import PartnerSearch, can_be_near, near_counts, occupancy, partners
from torchreg.verification.scans import prepared_scans

pytestmark = pytest.mark.skipif(not native_library(), reason="no compiler was at hand when the package was installed")


def both_ways(function, *arguments):
    """What a function gives by kernels, the same for any number of threads, and by torch alone."""
    results = []
    for count in (1, 2, 3):
        with threads(count):
            results.append(function(*arguments))
    assert all(same_bits(result, results[0]) for result in results)
    with native_kernels(False):
        return results[0], function(*arguments)


def near_poses(T, count, seed):
    """A pose, and others ever farther away from it."""
    g = torch.Generator().manual_seed(seed)
    poses = T.repeat(count, 1, 1)
    for h in range(1, count):
        poses[h, :3, 3] += 0.05 * h * torch.randn(3, generator=g)
        if h > count // 2:
            poses[h] = random_transform(g, reach=1.0) @ T
    return poses


def scans_of(clouds, features, sample, limit):
    prepared = [tr.estimate_normals(cloud, tr.neighbors(cloud, 0.3, 30)) for cloud in clouds]
    return prepared_scans(prepared, [0.1] * len(clouds), limit, sample, features)


@pytest.mark.parametrize("sample", [40, 700, 1500])
@pytest.mark.parametrize("colored", [False, True])
@pytest.mark.parametrize("viewpoint", [None, 1.2])
def test_evidence_of_several_pairs(sample, colored, viewpoint):
    g = torch.Generator().manual_seed(sample)
    pairs = [room_pair(points, seed=points) for points in (900, 2500)]
    limit = torch.tensor([0.15, 0.4], dtype=torch.float64)
    sides = []
    for side in ("source", "target"):
        clouds = [getattr(pair, side) for pair in pairs]
        features = [
            (
                torch.rand(len(cloud.points), 33, generator=g),
                torch.rand(len(cloud.points), 5, generator=g) if colored else None,
            )
            for cloud in clouds
        ]
        if not colored:
            clouds = [replace(cloud, colors=None) for cloud in clouds]
        known = None if viewpoint is None else torch.full((1, 3), viewpoint)
        clouds = [replace(cloud, viewpoint=known) for cloud in clouds]
        sides.append(scans_of(clouds, features, sample, limit))
    T = torch.cat([near_poses(pair.T_target_source.reshape(4, 4), 9, seed) for seed, pair in enumerate(pairs)])
    pair = torch.tensor([0] * 9 + [1] * 9)
    by_kernels, by_torch = both_ways(evidence, *sides, pair, T[:, :3, :3], T[:, :3, 3], limit)
    assert same_bits(by_kernels, by_torch)
    assert float(by_torch.overlap[0]) > 0.3
    assert bool(by_torch.conflict.isfinite().any()) == (viewpoint is not None)
    best = T[[0, 9]]
    by_kernels, by_torch = both_ways(overlap, *sides, best[:, :3, :3], best[:, :3, 3], limit)
    assert same_bits(by_kernels, by_torch)
    assert same_bits(*both_ways(weakest_motions, *by_torch))


@pytest.mark.parametrize("limit", [1e-3, 0.05, 0.4, 30.0])
@pytest.mark.parametrize("spread", [(1.0, 1.0, 1.0), (1.0, 0.0, 1.0), (0.0, 0.0, 0.0), (1000.0, 1.0, 1e-3)])
def test_partners_are_the_nearest_within_the_limit(limit, spread):
    g = torch.Generator().manual_seed(1)
    clouds = [torch.rand(size, 3, generator=g) * torch.tensor(spread) for size in (300, 1, 50)]
    pair = torch.tensor([0, 0, 1, 2, 2])
    moved = torch.stack([clouds[b][torch.randint(len(clouds[b]), (70,), generator=g)] for b in pair.tolist()])
    moved = (moved + limit * torch.randn(moved.shape, generator=g)).permute(2, 0, 1).contiguous()  # (3, 5, 70)
    moved[:, 1, 3], moved[:, 4, 5] = float("nan"), float("inf")
    valid = torch.rand(5, 70, generator=g) < 0.9
    search = PartnerSearch(torch.cat(clouds).t().contiguous(), [300, 1, 50], torch.full((3,), limit).double())
    square_limit = torch.full((5,), limit).square()
    found = partners(search, pair, moved, valid, square_limit)
    first = [0, 300, 301]
    for r, b in enumerate(pair.tolist()):
        x, y, z = (moved[:, r, :, None] - clouds[b].t()[:, None]).unbind(0)
        square, row = (x * x + y * y + z * z).min(dim=1)  # the first of several
        near = valid[r] & (square < square_limit[r])
        assert torch.equal(found.square[r] < square_limit[r], near)
        assert torch.equal(found.square[r][near], square[near])
        same_place = clouds[b][found.row[r][near] - first[b]] == clouds[b][row[near]]
        assert bool(same_place.all())
    assert bool((found.square < square_limit[:, None]).any())


def test_of_several_equally_near_points_the_lowest_row_is_the_partner():
    grid = torch.cartesian_prod(*[torch.arange(4.0)] * 3).repeat(2, 1)
    search = PartnerSearch(grid.t().contiguous(), [len(grid)], torch.tensor([1.0]).double())
    queries = grid[:64] + torch.tensor([0.5, 0.0, 0.0])
    with native_kernels():  # trees may take another
        found = partners(
            search, torch.tensor([0]), queries.t()[:, None].contiguous(), torch.ones(1, 64).bool(), torch.ones(1)
        )
    square = (queries[:, None] - grid).square().sum(dim=-1)
    assert torch.equal(found.row[0], square.argmin(dim=1))


@pytest.mark.parametrize("threshold", [1e-3, 0.1, 20.0])
def test_cells_around_points(threshold):
    g = torch.Generator().manual_seed(2)
    clouds = [size * torch.rand(count, 3, generator=g) - size / 2 for size, count in ((4.0, 300), (9.0, 1), (0.5, 80))]
    points, sizes = torch.cat(clouds).t().contiguous(), [len(cloud) for cloud in clouds]
    limits = torch.tensor([threshold, 2 * threshold, threshold], dtype=torch.float64)
    cells, by_torch = both_ways(occupancy, points, sizes, limits)
    assert same_bits(cells, by_torch)
    scan = torch.tensor([0, 1, 2, 2])
    queries = 3 * torch.randn(3, 4, 100, generator=g)
    queries[:, 2, 5], queries[:, 3, 7] = float("nan"), -float("inf")
    valid = torch.rand(4, 100, generator=g) < 0.5
    counts, expected = both_ways(near_counts, cells, scan, queries, valid)
    assert torch.equal(counts, expected)
    assert torch.equal(counts, (can_be_near(cells, scan, queries) & valid).sum(dim=1))


def test_visible_points_are_counted_alike():
    g = torch.Generator().manual_seed(3)
    sides = torch.tensor([8, 13])
    cells = int(sides.square().sum())
    ranges = 4 * torch.rand(cells, generator=g)
    ranges[::7] = float("inf")
    images = RangeImages(
        viewpoint=torch.tensor([[0.0, 1.0], [0.0, -1.0], [0.0, 0.5]]),
        ranges=ranges,
        seen=torch.isfinite(ranges) & (torch.rand(cells, generator=g) < 0.8),
        first=torch.tensor([0, 64]),
        side=sides,
        near=torch.tensor([0.5, 1.0]),
    )
    points = 2 * torch.randn(3, 5, 300, generator=g)
    points[:, 0, 0] = 0.0  # at the scanner
    points[2, 0, :100], points[1, 1, :50] = 0.0, -0.0
    which, valid = torch.tensor([0, 0, -1, 1, 1]), torch.rand(5, 300, generator=g) < 0.9
    margin = torch.full((5,), 0.2).double()
    counts, expected = both_ways(visible_counts, images, which, points, valid, margin)
    assert torch.equal(counts, expected)
    assert counts[:, 2].tolist() == [0, 0]
    assert bool((counts[:, [0, 1, 3, 4]] > 0).all())
