"""Which way is up: found in scenes of many kinds and frames, never mirrored; not claimed where nothing tells."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from problems import random_transform

import torchreg as tr
from torchreg.geometry.up import Up, up_of, upright_frame
from torchreg.report.scene import scene_of
from torchreg.report.views import VIEWS, axis_label, axis_words, view_label

REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "real"
NOWHERE = np.zeros(3)


def plane(rng, count, size, at):
    """Points (N, 3) of a rectangle whose middle and edges are given; an edge of 0 is its normal."""
    return (rng.random((count, 3)) - 0.5) * size + at


def street(rng):
    """What a scanner 1.7 m above a street sees: ground all round, a facade, a few trees; z is up."""
    parts = [plane(rng, 2500, (60, 60, 0.05), (0, 0, -1.7)), plane(rng, 800, (40, 0.05, 8), (0, 12, 2))]
    return rng.permutation(np.concatenate([*parts, *(plane(rng, 100, (1, 1, 5), (x, -9, 1)) for x in (-9, 3, 14))]))


def desk(rng, pitch):
    """What a camera held over a floor sees, looking along z with y down, pitched down by so many degrees."""
    floor = plane(rng, 900, (3, 0.02, 3), (0, 1.4, 2.6))
    wall = plane(rng, 1500, (4, 2.6, 0.02), (0, 0.1, 4.1))
    angle = np.radians(pitch)
    down = np.array(((1, 0, 0), (0, np.cos(angle), -np.sin(angle)), (0, np.sin(angle), np.cos(angle))))
    return rng.permutation(np.concatenate((floor, wall)) @ down.T)


def test_a_scanner_over_the_ground_has_z_up():
    rng = np.random.default_rng(0)
    found = up_of(street(rng), NOWHERE, NOWHERE, known=True)
    assert found.direction.tolist() == [0, 0, 1]
    assert found.reason == "a floor below the scanner"
    assert "the zero of the frame" in up_of(street(rng), NOWHERE, NOWHERE).reason


@pytest.mark.parametrize("seed", range(8))
def test_the_ground_around_a_scanner_is_found_in_any_frame(seed):
    R = random_transform(torch.Generator().manual_seed(seed))[:3, :3].numpy()
    points = street(np.random.default_rng(seed)) @ R.T
    found = up_of(points, NOWHERE, NOWHERE)
    assert found.direction @ R[:, 2] > np.cos(np.radians(6))
    frame = upright_frame(found, points, NOWHERE)
    heights = points @ frame[2]
    assert heights.min() > -2.5  # the ground is below, not above


def test_a_camera_has_y_down_and_its_pitch_follows_from_the_floor():
    rng = np.random.default_rng(0)
    level = up_of(desk(rng, 0), NOWHERE, NOWHERE)
    assert level.direction.tolist() == [0, -1, 0]
    pitched = up_of(desk(rng, 30), NOWHERE, NOWHERE)
    np.testing.assert_allclose(pitched.direction, (0, -np.cos(np.pi / 6), -np.sin(np.pi / 6)), atol=0.02)
    wall_alone = up_of(plane(rng, 2000, (2, 2, 0.02), (0, 0, 2)), NOWHERE, NOWHERE)
    assert (wall_alone.direction.tolist(), wall_alone.reason) == ([0, -1, 0], "a camera's frame, y down")


def test_nothing_is_claimed_where_nothing_tells():
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(3000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    for viewpoint in (None, NOWHERE):
        assert up_of(ball, viewpoint, NOWHERE).direction is None
    assert up_of(ball[:5], NOWHERE, NOWHERE) == Up(None, "too few points")
    assert up_of(ball[:0], None, NOWHERE).direction is None
    turned = random_transform(torch.Generator().manual_seed(0))[:3, :3].numpy()
    walls = [plane(rng, 800, size, at) for size, at in (((4, 0.02, 3), (0, 2, 0)), ((0.02, 4, 3), (2, 0, 0)))]
    assert up_of(np.concatenate((*walls, *(-wall for wall in walls))) @ turned.T, NOWHERE, NOWHERE).direction is None


def test_coordinates_of_a_map_have_z_up():
    ball = np.random.default_rng(0).normal(size=(300, 3))
    assert up_of(ball, None, np.array((4.5e5, 5.4e6, 0.0))).direction.tolist() == [0, 0, 1]


@pytest.mark.parametrize("seed", range(6))
def test_a_frame_is_a_rotation_with_up_on_top(seed):
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=3) if seed > 2 else np.eye(3)[seed] * (-1) ** seed
    direction /= np.linalg.norm(direction)
    for viewpoint in (None, 50 * rng.normal(size=3)):
        frame = upright_frame(Up(direction, ""), rng.random((100, 3)), viewpoint)
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(frame) == pytest.approx(1)
        np.testing.assert_allclose(frame[2], direction, atol=1e-12)
    assert np.array_equal(upright_frame(Up(None, ""), rng.random((100, 3)), np.ones(3)), np.eye(3))


@pytest.mark.parametrize("side", [(0, -1), (0, 1), (-1, 0), (1, 0)])
def test_the_front_is_where_the_scanner_stood(side):
    points = np.random.default_rng(0).random((500, 3))
    viewpoint = np.array((0.5 + 3 * side[0], 0.5 + 3 * side[1], 0.5))
    frame = upright_frame(Up(np.array((0.0, 0.0, 1.0)), ""), points, viewpoint)
    assert frame[1] @ viewpoint < (points @ frame[1]).min()


@pytest.mark.parametrize("view", VIEWS, ids=lambda view: view.name)
def test_no_view_is_mirrored(view):
    right, up, depth = (np.eye(3)[axis] for axis in (view.right, view.up, view.depth))
    assert np.cross(right, up) @ (view.toward * depth) == 1


@pytest.mark.parametrize(
    ("direction", "words"),
    [((1, 0, 0), "x"), ((0, -1, 0), "-y"), ((0.8, 0, -0.6), "0.80 x - 0.60 z"), ((-0.6, 0.8, 0), "-0.60 x + 0.80 y")],
)
def test_axes_are_named_by_those_of_the_file(direction, words):
    assert axis_words(np.array(direction, dtype=float)) == words


def test_labels_hold_for_the_points_that_are_drawn():
    """Reading a coordinate off a picture by its label gives the coordinate in the file."""
    rng = np.random.default_rng(0)
    origin = torch.tensor([[1200.0, -300.0, 7.0]], dtype=torch.float64)
    camera = tr.Clouds(points=torch.from_numpy(desk(rng, 0)).float(), origin=origin, viewpoint=torch.zeros(1, 3))
    scene = scene_of(camera, camera, 3000)
    assert [axis_label(scene, axis) for axis in range(3)] == ["x - 1200 (m)", "z - 7 (m)", "-y - 300 (m)"]
    in_file = camera.points.double().numpy() + origin.numpy()
    for axis, values in enumerate((in_file[:, 0] - 1200, in_file[:, 2] - 7, -in_file[:, 1] - 300)):
        assert sorted(scene.target[:, axis].round(4)) == sorted(values.round(4))
    assert [view_label(scene, view) for view in VIEWS] == [
        *("top view, along y", "front view, along z", "side view, along -x")
    ]


@pytest.mark.real
@pytest.mark.parametrize(
    ("scene", "along"),
    [("redkitchen", "-y"), ("ist_office", "-y"), ("sceaux_outdoor", "-y"), ("eth_facade_tls_nocolour", "z")],
)
def test_real_scans(scene, along):
    """Cameras have y down, and look down at most by 40 degrees; leveled scanners have z up."""
    if not REAL.is_dir():
        pytest.skip(f"no real scan pairs at {REAL}")
    axis = {"-y": (0, -1, 0), "z": (0, 0, 1)}[along]
    names = {pair["target"] for pair in json.loads((REAL / "pairs.json").read_text())["pairs"]}
    for name in sorted(name for name in names if name.startswith(scene)):
        cloud = tr.read_cloud(REAL / name)
        found = scene_of(cloud, cloud, 4000).up
        assert found.direction is not None, name
        assert found.direction @ axis > np.cos(np.radians(40)), (name, found)


@pytest.mark.real
def test_the_road_under_a_vehicle():
    """Scans that were turned at random: all of them have the road below, by the true poses."""
    folder = REAL.parent / "hard" / "sites" / "kitti01_highway"
    if not folder.is_dir():
        pytest.skip(f"no scans at {folder}")
    for scan in json.loads((folder / "site.json").read_text())["scans"][::4]:
        cloud = tr.read_cloud(folder / scan["file"])
        found = scene_of(cloud, cloud, 4000).up
        assert found.direction is not None, scan["file"]
        assert (np.array(scan["T_world_scan"])[:3, :3] @ found.direction)[2] > np.cos(np.radians(8))
