"""The last stage of ``register``: poses that succeed are refined, and everything said of them follows."""

from dataclasses import replace

import pytest
import torch
from determinism import same_bits, threads
from problems import room_pair, turned
from refusals import refuses

import torchreg as tr
from torchreg.neighborhoods.coverage import coverage
from torchreg.open3d_loader import load_open3d
from torchreg.registration import register_described
from torchreg.registration.describe import describe_by, description_of
from torchreg.registration.described import DescribedClouds
from torchreg.registration.options import REFINEMENTS

FIGURES = ("residual_median", "residual_rms", "residual_95", "covariance", "center", "axis_strength")
REFINED = ("T_target_source", "inliers", "fitness", "inlier_rmse", *FIGURES)


def off_by(result, pair):
    return float(tr.metrics.rmse(pair.T_target_source, result.T_target_source, pair.source.points))


@pytest.fixture(scope="module")
def mall():
    return tr.datasets.mall(seed=1, angular_step=1.0)


@pytest.fixture(scope="module")
def by_mode(mall):
    """The mall with each refinement."""
    return {mode: tr.register(mall.source, mall.target, refine=mode) for mode in REFINEMENTS}


def test_refinement_comes_closer_to_the_truth(mall, by_mode):
    off = {mode: off_by(result, mall) for mode, result in by_mode.items()}
    assert off["coarse"] < 0.5 * off["none"]
    assert off["full"] < 0.5 * off["none"]
    assert off["full"] < 0.01
    for mode in ("coarse", "full"):
        assert bool(by_mode[mode].success.all())
        assert float(by_mode[mode].residual_median) < 0.01


def test_without_refinement_there_are_no_figures(by_mode):
    assert all(getattr(by_mode["none"], name) is None for name in FIGURES)
    assert all(getattr(by_mode[mode], name) is not None for mode in ("coarse", "full") for name in FIGURES)


def test_only_the_pose_and_what_is_measured_under_it_change(by_mode):
    for mode in ("coarse", "full"):
        ignored = (*REFINED, "options", "seconds")
        assert same_bits(by_mode[mode], by_mode["none"], ignore=ignored)
        assert not torch.equal(by_mode[mode].T_target_source, by_mode["none"].T_target_source)
        assert by_mode[mode].options == (replace(by_mode["none"].options[0], refine=mode),)
        assert float(dict(by_mode[mode].seconds)["surfels"]) > 0


@pytest.mark.parametrize("mode", REFINEMENTS)
def test_fitness_and_inliers_belong_to_the_pose(by_mode, mode):
    result = by_mode[mode]
    T, threshold = result.T_target_source[0], result.options[0].inlier_threshold
    o3d = load_open3d()
    clouds = [
        o3d.geometry.PointCloud(o3d.utility.Vector3dVector((side.points.double() + side.origin[0]).numpy()))
        for side in (result.source, result.target)
    ]
    theirs = o3d.pipelines.registration.evaluate_registration(*clouds, threshold, T.numpy())
    assert float(result.fitness) == pytest.approx(theirs.fitness, abs=1e-4)
    assert float(result.inlier_rmse) == pytest.approx(theirs.inlier_rmse, rel=1e-3)
    shift = T[:3, 3] + T[:3, :3] @ result.source.origin[0] - result.target.origin[0]
    own = coverage(result.source.points, result.target.points, T[:3, :3], shift, threshold)
    assert float(result.fitness) == pytest.approx(float(own.fitness), abs=1e-9)
    one = result.source.points[result.correspondences.source].double() @ T[:3, :3].T + shift
    apart = (one - result.target.points[result.correspondences.target].double()).norm(dim=1)
    clear = (apart - threshold).abs() > 1e-6
    assert torch.equal(result.inliers[clear], (apart < threshold)[clear])


def test_the_covariance_covers_the_truth(mall, by_mode):
    result = by_mode["full"]
    back = mall.T_target_source.view(4, 4) @ torch.linalg.inv(result.T_target_source[0])
    turn = torch.stack([back[2, 1] - back[1, 2], back[0, 2] - back[2, 0], back[1, 0] - back[0, 1]]) / 2
    center = result.center[0]
    off = torch.cat([turn, back[:3, :3] @ center + back[:3, 3] - center])
    assert float(off @ torch.linalg.solve(result.covariance[0], off)) < 22.5  # 99.9 % of chi-squared with 6 degrees
    assert bool(((result.axis_strength >= 0) & (result.axis_strength <= 1)).all())


def test_points_of_the_refinement_bound_its_work(mall, by_mode):
    options = replace(by_mode["full"].options[0], refine_points=800)
    described = describe_by(mall.source, [description_of(options, colored=True)])
    assert 200 < len(described.surfels.cloud.points) < 1600
    result = tr.register(mall.source, mall.target, options)
    assert not torch.equal(result.T_target_source, by_mode["full"].T_target_source)
    assert off_by(result, mall) < off_by(by_mode["none"], mall)


def test_what_a_plain_effort_finds_is_not_refined_unless_asked():
    pair = room_pair(1500)
    options = tr.options_for(0.15, colored=True, effort="plain")
    assert (options.refine, tr.PAPER.refine, tr.options_for(0.15).refine) == ("none", "none", "full")
    found, asked = (tr.register(pair.source, pair.target, replace(options, refine=mode)) for mode in ("none", "full"))
    assert bool(found.success)
    assert off_by(asked, pair) < off_by(found, pair)


def mixed():
    """Three rooms, two that have nothing to do with each other, and a single point."""
    pairs = [room_pair(size, seed=size) for size in (900, 700)]
    single = tr.Clouds(points=torch.zeros(2, 3), colors=torch.zeros(2, 3), viewpoint=torch.zeros(1, 3))
    stranger = room_pair(800, seed=9, scale=3.0).source
    sources = [pairs[0].source, single, pairs[1].source, pairs[0].source]
    targets = [pairs[0].target, single, pairs[1].target, stranger]
    return tr.Clouds.pack(sources), tr.Clouds.pack(targets)


@pytest.mark.parametrize("mode", [pytest.param("coarse", marks=pytest.mark.slow), "full"])
def test_refused_pairs_are_untouched(mode):
    source, target = mixed()
    result, before = (tr.register(source, target, refine=each) for each in (mode, "none"))
    assert result.success.tolist() == before.success.tolist() == [True, False, True, False]
    for b in (1, 3):
        assert same_bits(result.T_target_source[b].clone(), before.T_target_source[b].clone())
        assert same_bits(result.fitness[b].clone(), before.fitness[b].clone())
        assert result.failure[b] == before.failure[b]
        assert result.notes[b] == before.notes[b]
        assert all(bool(getattr(result, name)[b].isnan().all()) for name in FIGURES)
    for b in (0, 2):
        assert all(bool(getattr(result, name)[b].isfinite().all()) for name in FIGURES)


@pytest.mark.parametrize("mode", [pytest.param("coarse", marks=pytest.mark.slow), "full"])
def test_batches_slices_and_threads_do_not_show(mode):
    source, target = mixed()
    whole = tr.register(source, target, refine=mode)
    for number in (2, 3):
        with threads(number):
            sliced = tr.register(source, target, refine=mode, max_bytes=1)
        assert same_bits(sliced, whole, ignore=("seconds",))
    for b in range(4):
        alone = tr.register(source.select(b), target.select(b), refine=mode)
        for name in REFINED[2:]:
            assert same_bits(getattr(alone, name)[0].clone(), getattr(whole, name)[b].clone()), (name, b)
        assert same_bits(alone.T_target_source[0].clone(), whole.T_target_source[b].clone())
        assert alone.notes[0] == whole.notes[b]


@pytest.mark.parametrize("mode", REFINEMENTS)
def test_described_clouds_give_the_same_bits(mode):
    pair = room_pair(900)
    result = tr.register(pair.source, pair.target, refine=mode)
    sides = (
        describe_by(cloud, [description_of(option, colored=True) for option in result.options])
        for cloud in (pair.source, pair.target)
    )
    described = register_described(*sides, result.options)
    assert same_bits(described, result, ignore=("seconds",))


def test_a_cloud_in_several_pairs_has_its_surfels_once(monkeypatch):
    from torchreg.registration import describe

    pair = room_pair(900)
    made = []
    surfels_of = describe.surfels_of

    def counted(clouds, count):
        made.append(len(clouds))
        return surfels_of(clouds, count)

    monkeypatch.setattr(describe, "surfels_of", counted)
    tr.register(tr.Clouds.pack([pair.source] * 3), tr.Clouds.pack([pair.target] * 3))
    assert sum(made) == 2


def test_the_frame_of_the_files_does_not_matter():
    pair = room_pair(900)
    utm = turned(0.0, translation=(512_345.25, 5_412_345.5, 431.125))
    far = tr.register(tr.transform(pair.source, utm), tr.transform(pair.target, utm))
    here = tr.register(pair.source, pair.target)
    back = torch.linalg.inv(utm) @ far.T_target_source[0] @ utm
    assert float(tr.metrics.rmse(back[None], here.T_target_source, pair.source.points)) < 2e-4
    torch.testing.assert_close(far.center - utm[:3, 3], here.center, rtol=0, atol=0.05)
    torch.testing.assert_close(far.residual_median, here.residual_median, rtol=0.2, atol=0)


def test_an_unknown_refinement_is_refused():
    pair = room_pair(100)
    with refuses("refine", "'none', 'coarse', 'full'", "'fine'"):
        tr.register(pair.source, pair.target, refine="fine")
    with refuses("refine_points", "100", "99"):
        tr.RegistrationOptions(refine_points=99)


def test_a_pose_that_covers_less_is_not_taken(monkeypatch):
    from torchreg.registration import refined

    pair = room_pair(900)
    none = tr.register(pair.source, pair.target, refine="none")
    refine_on_surfels = refined.refine_on_surfels

    def astray(*arguments):
        done = refine_on_surfels(*arguments)
        return done._replace(T_target_source=turned(0.0, translation=(0.6, 0.6, 0.6)) @ done.T_target_source)

    monkeypatch.setattr(refined, "refine_on_surfels", astray)
    result = tr.register(pair.source, pair.target)
    for name in ("T_target_source", "inliers", "fitness", "inlier_rmse", "success"):
        assert same_bits(getattr(result, name), getattr(none, name))
    assert result.notes == (("the pose is not refined: the thinned clouds would cover each other less",),)
    assert all(bool(getattr(result, name).isnan().all()) for name in FIGURES)


def test_described_clouds_bring_their_surfels_along():
    clouds = tr.Clouds.pack([room_pair(size).source for size in (300, 500)])
    options = replace(tr.options_for(0.2), refine_points=200)
    both = describe_by(clouds, [description_of(options, colored=True)] * 2)
    parts = both.unpack()
    assert same_bits(DescribedClouds.pack(parts).surfels, both.surfels)
    assert same_bits((both.clone().surfels, both.to("cpu").surfels), (both.surfels, both.surfels))
    left = both.without([True, False]).surfels
    assert left.cloud.lengths[0] == 0
    assert same_bits(left.unpack()[1].cloud.points, parts[1].surfels.cloud.points)
    bare = describe_by(clouds, [description_of(replace(options, refine="none"), colored=True)] * 2)
    assert bare.surfels is None
    assert DescribedClouds.pack(bare.unpack()).clone().without([True, False]).surfels is None
