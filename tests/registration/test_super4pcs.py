"""Registration by congruent sets: known truth at several overlaps, the same bits whatever stands beside, bad clouds."""

from dataclasses import replace

import pytest
import torch
from determinism import same_bits, threads
from problems import plane_cloud, seeded, turned

import torchreg as tr

T_TRUE = turned(130, (0.2, -0.5, 1.0), (3.0, -1.0, 0.5))
SEARCH = tr.Super4pcsOptions(points=700, bases=64)


def ground(overlap, *, points=1500, noise=0.01, outliers=0.05, seed=0):
    """Two scans of rough ground of 4 m x 3 m each, which have this share in common, with noise and stray points."""
    generator = seeded(seed)
    bumps = torch.rand(40, 4, generator=generator, dtype=torch.float64)
    centers = bumps[:, :2] * torch.tensor([8.0, 3.0], dtype=torch.float64)
    heights, widths = bumps[:, 2] - 0.3, 0.25 + 0.4 * bumps[:, 3]
    clouds = []
    for begin in (0.0, 4.0 * (1 - overlap)):
        xy = torch.rand(points, 2, generator=generator, dtype=torch.float64) * torch.tensor([4.0, 3.0])
        xy[:, 0] += begin
        square = (xy[:, None] - centers).square().sum(dim=2)
        z = (heights * torch.exp(-square / (2 * widths**2))).sum(dim=1, keepdim=True)
        cloud = torch.cat([xy, z], dim=1)
        cloud += noise * torch.randn(cloud.shape, generator=generator, dtype=torch.float64)
        stray = torch.rand(int(outliers * points), 3, generator=generator, dtype=torch.float64)
        stray = stray * torch.tensor([4.0, 3.0, 1.5]) + torch.tensor([begin, 0.0, -0.5])
        cloud = torch.cat([cloud, stray])
        scanner = torch.tensor([[begin + 2.0, 1.5, 6.0]], dtype=torch.float64)
        clouds.append((cloud, scanner))
    (p, from_p), (q, from_q) = clouds
    R, t = T_TRUE[:3, :3], T_TRUE[:3, 3]
    source = tr.Clouds(points=p.float(), viewpoint=from_p.float())
    target = tr.Clouds(points=(q @ R.t() + t).float(), viewpoint=(from_q @ R.t() + t).float())
    return source, target


@pytest.mark.parametrize("overlap", [1.0, 0.6, pytest.param(0.3, marks=pytest.mark.slow)])
def test_known_truth_is_found_and_called_right(overlap):
    source, target = ground(overlap)
    search = replace(SEARCH, overlap=min(0.8 * overlap, 0.5), bases=128)
    result = tr.super4pcs(source, target, search=search)
    T = result.T_target_source[0]
    assert float(tr.metrics.rre(T_TRUE, T)) < 2
    assert float(tr.metrics.rte(T_TRUE, T)) < 0.1
    assert bool(result.success[0]), result.reason
    assert float(result.probability[0]) > 0.6
    assert int(result.hypotheses.drawn[0]) > 0
    assert int(result.hypotheses.scored[0]) > 0


def test_normals_may_be_left_out():
    source, target = ground(1.0, points=500)
    search = replace(SEARCH, points=300, normal_degrees=180.0, bases=8)
    result = tr.super4pcs(source, target, search=search)
    assert float(tr.metrics.rre(T_TRUE, result.T_target_source[0])) < 5


def test_the_seed_alone_decides():
    source, target = ground(0.8, points=600)

    def run(seed=0):
        return tr.super4pcs(source, target, search=replace(SEARCH, points=300, bases=16), seed=seed, refine="none")

    first = run()
    for number in (2, 3):
        with threads(number):
            assert same_bits(first, run(), ignore=("seconds",))
    assert not torch.equal(first.hypotheses.kept, run(seed=1).hypotheses.kept)


def test_neither_batch_nor_memory_shows():
    pairs = [ground(1.0, points=400, seed=seed) for seed in (1, 2)]
    search = replace(SEARCH, points=300, bases=16)
    source, target = (tr.Clouds.pack(side) for side in zip(*pairs, strict=True))
    both = tr.super4pcs(source, target, search=search, refine="none")
    little = tr.super4pcs(source, target, search=search, refine="none", max_bytes=1)
    assert same_bits(both, little, ignore=("seconds",))
    for b, pair in enumerate(pairs):
        alone = tr.super4pcs(*pair, search=search, refine="none")
        assert torch.equal(alone.T_target_source[0], both.T_target_source[b])
        assert torch.equal(alone.probability[0], both.probability[b])


def test_a_bad_pair_fails_with_its_reason_and_leaves_the_others_alone():
    good = ground(1.0, points=400)
    line = torch.linspace(0, 1, 50)[:, None] * torch.tensor([[1.0, 2.0, 3.0]])
    bad = {
        "too few points": torch.zeros(2, 3),
        "degenerate": line,
        "not finite": torch.full((50, 3), float("nan")),
    }
    viewpoint = good[0].viewpoint
    sources = [good[0], *(tr.Clouds(points=points, viewpoint=viewpoint) for points in bad.values())]
    source, target = tr.Clouds.pack(sources), tr.Clouds.pack([good[1]] * len(sources))
    search = replace(SEARCH, points=300, bases=16)
    result = tr.super4pcs(source, target, search=search, refine="none")
    assert [failure.kind for failure in result.failure[1:]] == list(bad)
    assert not bool(result.success[1:].any())
    alone = tr.super4pcs(*good, search=search, refine="none")
    assert torch.equal(alone.T_target_source[0], result.T_target_source[0])


def test_a_plane_is_no_success():
    one, other = plane_cloud(600, 4.0, seed=1), plane_cloud(600, 4.0, seed=2)
    result = tr.super4pcs(one, other, search=replace(SEARCH, points=300, bases=8))
    assert not bool(result.success[0])
    assert result.reason[0]


def test_a_symmetric_place_is_told_to_be_ambiguous():
    corners = torch.rand(900, 3, generator=seeded(3), dtype=torch.float64)
    face = torch.arange(900) % 6
    points = corners - 0.5
    points[torch.arange(900), face % 3] = torch.where(face < 3, 0.5, -0.5).double()  # a cube
    source, target = tr.Clouds(points=points[::2].float()), tr.Clouds(points=points[1::2].float())
    result = tr.super4pcs(source, target, search=replace(SEARCH, points=400, bases=8))
    assert not bool(result.success[0])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("overlap", 0.0),
        ("overlap", 1.5),
        ("bases", 0),
        ("points", 3),
        ("threshold", 0.0),
        ("normal_degrees", -1.0),
        ("normal_degrees", 180.5),
    ],
)
def test_options_out_of_range_are_refused_by_name(name, value):
    with pytest.raises(ValueError, match=name):
        tr.Super4pcsOptions(**{name: value})
