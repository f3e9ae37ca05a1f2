"""Open3D's information matrix to rounding; the weakest motion is the one that the surfaces leave open."""

import numpy as np
import pytest
import torch

from torchreg.open3d_loader import load_open3d
from torchreg.verification.information import information_matrices, weakest_motions


def filled_up(values):
    """Rows (N, 3) as (3, 1, L), and where they stand."""
    width = len(values) + 7
    planes = torch.full((3, 1, width), 7.0, dtype=values.dtype)
    planes[:, 0, : len(values)] = values.t()
    return planes, (torch.arange(width) < len(values))[None]


def information_matrix(points):
    return information_matrices(*filled_up(points))[0]


def weakest_motion(points, normals):
    motions = weakest_motions(filled_up(points)[0], *filled_up(normals))
    return type(motions)(*(part[0] for part in motions))


def test_the_information_matrix_is_open3ds():
    o3d = load_open3d()
    points = torch.rand(200, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) * 4 - 1
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.numpy()))
    theirs = o3d.pipelines.registration.get_information_matrix_from_point_clouds(cloud, cloud, 0.01, np.eye(4))
    assert np.allclose(information_matrix(points).numpy(), theirs, rtol=1e-12, atol=1e-9)


def faces(*normals, count=400, seed=0):
    """Points on unit faces across these axes, and their normals."""
    g = torch.Generator().manual_seed(seed)
    points, directions = [], []
    for axis, side in normals:
        face = torch.rand(count, 3, generator=g) - 0.5
        face[:, axis] = side * 0.5
        direction = torch.zeros(count, 3)
        direction[:, axis] = side
        points.append(face)
        directions.append(direction)
    return torch.cat(points), torch.cat(directions)


def test_a_room_is_held():
    motion = weakest_motion(*faces((0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1)))
    assert float(motion.strength) > 0.4


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_corridor_slides_along_its_axis(axis):
    walls = [(other, side) for other in range(3) if other != axis for side in (1, -1)]
    motion = weakest_motion(*faces(*walls))
    assert float(motion.strength) < 1e-6
    assert float(motion.shift[axis].abs()) == pytest.approx(1.0, abs=1e-6)
    assert float(motion.turn.abs().max()) < 1e-6


def test_a_plane_slides():
    motion = weakest_motion(*faces((2, 1)))
    assert float(motion.strength) < 1e-6
    assert float(motion.shift[2].abs()) < 1e-6


def test_a_ball_turns():
    g = torch.Generator().manual_seed(0)
    normals = torch.nn.functional.normalize(torch.randn(3000, 3, generator=g), dim=1)
    motion = weakest_motion(2 * normals + 5, normals)
    assert float(motion.strength) < 1e-3
    assert float(motion.turn.norm()) * 2 == pytest.approx(1.5**0.5, rel=0.05)  # rms 1 m over a sphere
    assert torch.allclose(motion.center, torch.full((3,), 5.0, dtype=torch.float64), atol=0.1)


@pytest.mark.parametrize("scale", [0.01, 1.0, 100.0])
def test_strength_does_not_depend_on_the_unit(scale):
    points, normals = faces((0, 1), (1, 1), (2, 1))
    large, small = weakest_motion(points * scale, normals).strength, weakest_motion(points, normals).strength
    assert float(large) == pytest.approx(float(small), rel=1e-6)


@pytest.mark.parametrize("count", [0, 1, 5])
def test_too_few_points_hold_nothing(count):
    assert float(weakest_motion(torch.rand(count, 3), torch.rand(count, 3)).strength) == 0.0
