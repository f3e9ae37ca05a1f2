"""Properties of the simulated road: its truth, its light, what it is made of, and that it is the same every time."""

import numpy as np
import pytest
import torch
from scans import colors_of, in_target, nearest, thinned

from torchreg.datasets import ScanPair, road
from torchreg.synthetic.scene.light import Light, daylight, irradiance
from torchreg.synthetic.scene.paint import paint
from torchreg.synthetic.scene.quads import prism, rectangles
from torchreg.synthetic.scene.scanner import Raycaster

STEP = 1.0


@pytest.fixture(scope="module")
def pair() -> ScanPair:
    return road(0, angular_step=STEP)


@pytest.mark.parametrize("seed", [0, 3])
def test_truth_brings_the_scans_together(seed):
    scans = road(seed, angular_step=0.5)
    assert min(scans.source.lengths + scans.target.lengths) > 50_000
    assert max(scans.source.lengths + scans.target.lengths) < 300_000
    moved, target = in_target(scans), scans.target.points.numpy()
    rows = thinned(moved)
    rows = rows[np.linalg.norm(moved[rows], axis=1) < 20]  # where the target is dense
    assert (nearest(moved[rows], target)[1] < 0.1).mean() > 0.4
    still = scans.source.points.numpy()
    still = still[thinned(still)]
    still = still[np.linalg.norm(still, axis=1) < 20]
    assert (nearest(still, target)[1] < 0.1).mean() < 0.25


def test_ground_lies_under_the_scanner_and_fronts_rise_beside_it(pair):
    """Upright, as the tilt is less than two degrees."""
    points = pair.source.points
    flat = points[:, :2].norm(dim=1)
    below = points[(flat < 3) & (points[:, 2] < 0), 2]
    assert -2.0 < below.median() < -1.3
    assert below.std() < 0.15
    assert ((points[:, 2] > 3) & (flat > 8)).float().mean() > 0.05
    assert points[:, 2].max() > 5


def test_lawns_and_trees_are_green_and_asphalt_is_gray(pair):
    color = colors_of(pair.source)
    red, green, blue = color.unbind(1)
    grassy = (green > 1.15 * blue) & (green > 0.95 * red)
    assert 0.05 < grassy.float().mean() < 0.6
    near = pair.source.points.norm(dim=1) < 2.5
    spread = color[near].amax(dim=1) - color[near].amin(dim=1)
    assert spread.median() < 0.12


@pytest.mark.parametrize("seed", [0, 1])
def test_relight_changes_colors_and_nothing_else(seed):
    alike, relit = (road(seed, angular_step=STEP, relight=relight) for relight in (0.0, 1.0))
    for a, b in ((alike.source, relit.source), (alike.target, relit.target)):
        assert torch.equal(a.points, b.points)
    change = [(colors_of(a.source) - colors_of(b.source)).abs().mean() for a, b in ((alike, alike), (alike, relit))]
    assert change[0] == 0
    assert change[1] > 0.03


def test_shadows_in_the_open_are_bluer_than_sunlit_ground():
    """A roof over level ground: under it only the sky's rim shines, beside it the sun too."""
    roof = Raycaster(rectangles((0, 0, 3), (8, 0, 0), (0, 8, 0), paint(np.random.default_rng(0), (0.5, 0.5, 0.5))))
    light = daylight(1.0, np.random.default_rng(0))
    up = np.array([[0.0, 0.0, 1.0]] * 2)
    shaded, sunlit = irradiance(np.array([(0.0, 0, 0), (40.0, 0, 0)]), up, light, roof)
    assert sunlit.mean() > 3 * shaded.mean()
    assert shaded[2] / shaded[0] > 1.1 * sunlit[2] / sunlit[0]


def test_even_sky_lights_the_ground_fully_and_walls_by_half():
    nothing = Raycaster(rectangles((0, 0, -9), (1, 0, 0), (0, 1, 0), paint(np.random.default_rng(0), (0.5, 0.5, 0.5))))
    light = Light(
        ambient=np.zeros(3), sun=np.zeros(3), sun_direction=np.array([0.0, 0.0, 1.0]), dome=np.array([1.0, 2.0, 3.0])
    )
    normals = np.array([(0, 0, 1), (1, 0, 0), (0, -1, 0), (0, 0, -1)], dtype=np.float64)
    got = irradiance(np.zeros((4, 3)), normals, light, nothing)
    assert got[0] == pytest.approx([1, 2, 3])
    assert got[1:3] == pytest.approx(np.outer([0.5, 0.5], [1, 2, 3]), rel=0.15)
    assert (got[3] == 0).all()


def test_prism_is_closed_and_where_its_profile_says():
    gray = paint(np.random.default_rng(0), (0.5, 0.5, 0.5))
    caster = Raycaster(prism([(-1, 0), (1, 0), (1, 1), (0, 2)], 3.0, gray))
    rays = np.array([(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1), (-1, 0, 0)], dtype=np.float64)
    reach, _, uv, _ = caster.cast(np.array([0.2, 0.0, 0.5]), rays)
    assert reach == pytest.approx([0.8, 1.5, 1.3, 0.5, 0.95], abs=1e-5)
    assert uv[1] == pytest.approx([0.2, 0.5], abs=1e-5)
