"""Properties of the simulated mall: its truth, its noise, its light, and that it is the same every time."""

import math

import numpy as np
import pytest
import torch
from scans import colors_of, in_target, nearest, thinned

from torchreg.datasets import ScanPair, mall
from torchreg.open3d_loader import load_open3d
from torchreg.synthetic.scene import Array
from torchreg.synthetic.scene.light import DISPLAY_GAMMA, Camera, develop
from torchreg.synthetic.scene.paint import paint
from torchreg.synthetic.scene.quads import Quads, balls, boxes, cylinders, rectangles
from torchreg.synthetic.scene.scanner import Raycaster
from torchreg.types.clouds import Clouds

STEP = 1.0


@pytest.fixture(scope="module")
def pair() -> ScanPair:
    return mall(0, angular_step=STEP)


def test_points_lie_where_a_scanner_of_this_kind_sees(pair):
    for cloud in (pair.source, pair.target):
        reach = cloud.points.norm(dim=1)
        assert reach.min() > 0.5
        assert reach.max() < 45  # across the hall and into a shop
        elevation = torch.rad2deg(torch.asin(cloud.points[:, 2] / reach))
        assert elevation.min() > -60.01  # the blind cone is empty
        # Without the tilt taken out, each point lies on a ray of the grid of equal steps.
        azimuth = torch.rad2deg(torch.atan2(cloud.points[:, 1], cloud.points[:, 0]))
        level = elevation < 80
        for angle in (azimuth[level], elevation[level]):
            assert (angle / STEP - (angle / STEP).round()).abs().max() < 1e-2


@pytest.mark.parametrize("seed", [0, 3])
def test_truth_brings_the_scans_together(seed):
    scans = mall(seed)
    assert min(scans.source.lengths + scans.target.lengths) > 100_000
    assert max(scans.source.lengths + scans.target.lengths) < 300_000
    moved, target = in_target(scans), scans.target.points.numpy()
    rows = thinned(moved)
    assert (nearest(moved[rows], target)[1] < 0.05).mean() > 0.3
    still = scans.source.points.numpy()
    assert (nearest(still[thinned(still)], target)[1] < 0.05).mean() < 0.2


def test_truth_is_where_icp_stays():
    o3d = load_open3d()
    scans = mall(0, angular_step=0.7)
    source, target = (
        o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.points.double().numpy()))
        for cloud in (scans.source, scans.target)
    )
    target.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(0.3, 30))
    point_to_plane = o3d.pipelines.registration.TransformationEstimationPointToPlane()
    truth = scans.T_target_source.numpy()
    found = o3d.pipelines.registration.registration_icp(source, target, 0.1, truth, point_to_plane).transformation
    error = found @ np.linalg.inv(truth)
    assert np.degrees(np.arccos(np.clip((np.trace(error[:3, :3]) - 1) / 2, -1, 1))) < 0.05
    assert np.linalg.norm(error[:3, 3]) < 0.01


def test_range_noise_is_along_the_ray_and_as_large_as_asked():
    clean, noisy = (mall(4, angular_step=STEP, range_noise=noise) for noise in (0.0, 0.004))
    assert clean.source.lengths == noisy.source.lengths
    assert torch.equal(colors_of(clean.source), colors_of(noisy.source))
    reach, noisy_reach = clean.source.points.norm(dim=1), noisy.source.points.norm(dim=1)
    direction, noisy_direction = clean.source.points / reach[:, None], noisy.source.points / noisy_reach[:, None]
    assert (direction - noisy_direction).abs().max() < 1e-5
    error = noisy_reach - reach
    assert abs(error.mean()) < 2e-4
    near, far = error[reach < 5].std(), error[reach > 10].std()
    assert 0.002 < near < 0.006
    assert near < far < 0.02


def color_change(scans: ScanPair) -> Array:
    """Difference of the mean colors (3,) where both scans see the same surface."""
    index, apart = nearest(in_target(scans), scans.target.points.numpy())
    same = apart < 0.02
    assert same.sum() > 300
    change = colors_of(scans.target).numpy()[index[same]] - colors_of(scans.source).numpy()[same]
    return change.mean(axis=0)


@pytest.mark.parametrize("seed", [0, 1])
def test_relight_changes_colors_and_nothing_else(seed):
    alike, relit = (mall(seed, angular_step=STEP, relight=relight) for relight in (0.0, 1.0))
    assert torch.equal(alike.source.points, relit.source.points)
    assert torch.equal(alike.target.points, relit.target.points)
    assert np.abs(color_change(alike)).max() < 0.01
    assert np.abs(color_change(relit)).max() > 0.03


def test_much_is_gray_and_something_is_strongly_colored():
    shares = []
    for seed in range(4):
        color = colors_of(mall(seed, angular_step=2.0).source)
        high, low = color.amax(dim=1), color.amin(dim=1)
        shares.append(((high - low > 0.3 * high) & (high > 0.15)).float().mean().item())
    assert 0.1 < np.mean(shares) < 0.6
    assert min(shares) > 0.03


def test_some_points_stand_in_one_scan_only():
    """Both stations nearly in one place: what is then missing nearby has moved or walked away."""
    scans = mall(0, baseline=0.1, angular_step=0.7)
    moved = in_target(scans)
    close = np.linalg.norm(moved, axis=1) < 8
    apart = nearest(moved[close], scans.target.points.numpy())[1]
    assert 0.002 < (apart > 0.2).mean() < 0.2


def test_scan_pair_refuses_what_it_cannot_hold(pair):
    with pytest.raises(ValueError, match="target: expected one cloud, got 2 clouds"):
        ScanPair(pair.source, Clouds.pack([pair.target, pair.target]), pair.T_target_source, "x")
    with pytest.raises(ValueError, match="T_target_source: expected float64"):
        ScanPair(pair.source, pair.target, pair.T_target_source.float(), "x")
    with pytest.raises(ValueError, match=r"information: expected \(6, 6\), got \(4, 4\)"):
        ScanPair(pair.source, pair.target, pair.T_target_source, "x", pair.T_target_source)


def test_rays_meet_the_solids_where_geometry_says():
    rng = np.random.default_rng(0)
    gray = paint(rng, (0.5, 0.5, 0.5))
    scene = Quads.join(
        [
            rectangles((0, 0, -2), (20, 0, 0), (0, 20, 0), gray),
            boxes((5, 0, 0), (2, 2, 2), gray, yaw=np.pi / 4),
            cylinders((0, 5, -2), 1.0, 4.0, gray, sides=360),
            balls((-5, 0, 0), (1, 2, 3), gray, sides=180),
        ]
    )
    ways = np.array([(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, 0, -1), (0, 0, 1)], dtype=np.float64)
    reach, _, uv, normals = Raycaster(scene).cast(np.zeros(3), ways)
    assert reach[:4] == pytest.approx([5 - math.sqrt(2), 4, 4, 2], abs=1e-3)
    assert np.isinf(reach[4])
    assert uv[3] == pytest.approx([0, 0], abs=1e-6)
    assert np.abs(normals[3]) == pytest.approx([0, 0, 1])


def test_camera_keeps_gray_gray_and_ends_at_white():
    gray = np.full((4, 3), 0.5) * np.array([0.0, 0.2, 1.0, 100.0])[:, None]
    colors = develop(gray, Camera(gain=1.0, white_balance=np.ones(3), noise=0.0), np.random.default_rng(0))
    assert (colors == colors[:, :1]).all()
    assert colors[:, 0].tolist() == sorted(colors[:, 0].tolist())
    assert colors[0, 0] == 0
    assert colors[1, 0] == round(255 * 0.1 ** (1 / DISPLAY_GAMMA))
    assert colors[3, 0] == 255
