"""3D shape contexts: plain loops say the same, frames turn with the cloud, and signs of normals mirror."""

import math

import pytest
import torch
from closeness import close
from determinism import same_bits
from problems import random_transform, sphere_cloud
from refusals import refuses

import torchreg as tr
from torchreg.descriptors.shape_context import tangent_frames

BINS = (12, 11, 15)


def context_of(cloud, near, frames, row, bins=BINS, inner=0.1, density=0.2):
    """One shape context by a loop over neighbors."""
    out = torch.zeros(bins, dtype=torch.float64)
    azimuths, elevations, rings = bins
    edges = [near.radius * inner * (1 / inner) ** (j / rings) for j in range(rings + 1)]
    for other in near.index[row][near.valid[row]].tolist():
        line = cloud.points[other] - cloud.points[row]
        distance = float(line.norm())
        if distance == 0:
            continue
        x, y, z = (frames[row] @ line).tolist()
        turn_bin = min(azimuths - 1, int(math.atan2(y, x) % (2 * math.pi) / (2 * math.pi) * azimuths))
        rise_bin = min(elevations - 1, int(math.acos(z / distance) / math.pi * elevations))
        ring = max(0, sum(distance > edge for edge in edges) - 1)
        around = int(((cloud.points - cloud.points[other]).norm(dim=1) < density * near.radius).sum())
        turn, tops = (
            2 * math.pi / azimuths,
            [math.cos(math.pi * part / elevations) for part in (rise_bin, rise_bin + 1)],
        )
        volume = turn * (tops[0] - tops[1]) * (edges[ring + 1] ** 3 - edges[ring] ** 3) / 3
        out[turn_bin, rise_bin, ring] += 1 / (around * volume ** (1 / 3))
    return out.flatten()


def described(cloud, radius=0.9, **options):
    near = tr.neighbors(cloud, radius, len(cloud.points))
    return tr.shape_context(cloud, near, **options)


@pytest.mark.parametrize("options", [{}, {"bins": (4, 3, 2), "inner": 0.4, "density": 0.5}])
def test_values_are_those_of_plain_loops(options):
    cloud = sphere_cloud(120, seed=4)
    near = tr.neighbors(cloud, 0.9, 120)
    frames = tangent_frames(cloud.points, cloud.normals, near)
    found = tr.shape_context(cloud, near, **options)
    assert found.blocks == (("shape_context", math.prod(options.get("bins", BINS))),)
    for row in range(0, 120, 11):
        assert close(found.values[row], context_of(cloud, near, frames, row, **options), atol=1e-6)


def test_frames_are_right_handed_and_turn_with_the_cloud():
    cloud = sphere_cloud(200)
    T = random_transform(torch.Generator().manual_seed(2))
    moved = tr.transform(cloud, T)
    one, other = (tangent_frames(each.points, each.normals, tr.neighbors(each, 0.8, 60)) for each in (cloud, moved))
    eye = torch.eye(3, dtype=torch.float64).expand(200, 3, 3)
    assert close(one @ one.mT, eye, atol=1e-9)
    assert close(torch.linalg.det(one), torch.ones(200, dtype=torch.float64), atol=1e-9)
    assert close(one[:, 2], cloud.normals, atol=1e-12)
    assert close(other, one @ T[:3, :3].mT.to(one), atol=1e-6)


@pytest.mark.parametrize("unit", [2.0**-30, 2.0**30])
def test_the_unit_of_points_does_not_show(unit):
    cloud = sphere_cloud(120, seed=4).to(dtype=torch.float32)
    other = tr.Clouds(points=unit * cloud.points, normals=cloud.normals)
    near, far = tr.neighbors(cloud, 0.75, 40), tr.neighbors(other, 0.75 * unit, 40)
    frames = tangent_frames(cloud.points, cloud.normals, near)
    assert same_bits(tangent_frames(other.points, other.normals, far), frames)
    for binning in ("hard", "soft"):
        found = tr.shape_context(other, far, binning=binning).values
        assert same_bits(unit * found, tr.shape_context(cloud, near, binning=binning).values)


def test_x_is_found_where_neighbors_lie_close_to_the_normal():
    aside = torch.tensor([0.8, 0.6, 0.0])
    points = torch.stack([torch.zeros(3), *(1e-13 * (k + 1) * aside for k in range(4))])
    points[1:, 2] = torch.tensor([0.1, 0.2, 0.3, -0.2])
    cloud = tr.Clouds(points=points, normals=torch.tensor([0.0, 0, 1]).expand(5, 3))
    frame = tangent_frames(cloud.points, cloud.normals, tr.neighbors(cloud, 1.0, 5))[0]
    assert close(frame[0], aside, atol=1e-3)


def test_x_points_where_most_neighbors_lie():
    line = torch.tensor([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [-0.1, 0, 0], [0, 0.05, 0]])
    cloud = tr.Clouds(points=line, normals=torch.tensor([0.0, 0, 1]).expand(5, 3))
    frame = tangent_frames(cloud.points, cloud.normals, tr.neighbors(cloud, 1.0, 5))[0]
    assert float(frame[0, 0]) > 0.9


def test_given_frames_need_no_normals():
    cloud = sphere_cloud(100)
    near = tr.neighbors(cloud, 0.8, 60)
    frames = tangent_frames(cloud.points, cloud.normals, near)
    bare = tr.Clouds(points=cloud.points)
    assert same_bits(tr.shape_context(bare, near, frames=frames).values, tr.shape_context(cloud, near).values)


def test_a_turn_about_z_moves_cells_of_azimuth():
    cloud = sphere_cloud(150)
    near = tr.neighbors(cloud, 0.8, 60)
    frames = tangent_frames(cloud.points, cloud.normals, near)
    step = 2 * math.pi / 12
    back = frames.clone()
    back[:, 0] = math.cos(step) * frames[:, 0] - math.sin(step) * frames[:, 1]
    back[:, 1] = math.sin(step) * frames[:, 0] + math.cos(step) * frames[:, 1]
    plain = tr.shape_context(cloud, near, frames=frames).values.view(-1, *BINS)
    turned = tr.shape_context(cloud, near, frames=back).values.view(-1, *BINS)
    assert close(turned, plain.roll(1, dims=1), atol=1e-9)


def test_a_point_without_frame_or_neighbor_is_not_valid():
    points = torch.tensor([[0.0, 0, 0], [0.1, 0, 0], [9.0, 9, 9]])
    cloud = tr.Clouds(points=points, normals=torch.tensor([0.0, 0, 1]).expand(3, 3))
    near = tr.neighbors(cloud, 1.0, 3)
    assert tr.shape_context(cloud, near).valid.tolist() == [True, True, False]
    frames = torch.eye(3).repeat(3, 1, 1)
    frames[1] = 0
    for binning in ("hard", "soft"):
        features = tr.shape_context(cloud, near, frames=frames, binning=binning)
        assert features.valid.tolist() == [True, False, False]
        assert torch.isfinite(features.values).all()


def test_points_in_one_place_describe_nothing():
    cloud = tr.Clouds(points=torch.ones(5, 3), normals=torch.tensor([0.0, 0, 1]).expand(5, 3))
    for binning in ("hard", "soft"):
        assert not tr.shape_context(cloud, tr.neighbors(cloud, 1.0, 5), binning=binning).valid.any()


def test_neighbors_on_the_normal_have_no_azimuth():
    points = torch.tensor([[0.0, 0, 0], [0, 0, 0.5], [0, 0, -0.2], [0.3, 0.1, 0]])
    cloud = tr.Clouds(points=points)
    features = tr.shape_context(cloud, tr.neighbors(cloud, 1.0, 4), frames=torch.eye(3).expand(4, 3, 3).clone())
    cells = features.values[0].view(BINS)
    assert (cells[:, 0].sum(dim=1) > 0).nonzero().flatten().tolist() == [0]
    assert (cells[:, -1].sum(dim=1) > 0).nonzero().flatten().tolist() == [0]


def test_what_is_unsigned_does_not_know_the_sign_of_normals():
    cloud = sphere_cloud(150)
    record, near = tr.ShapeContext(radius=0.7), tr.neighbors(cloud, 0.7, 60)
    turned = tr.Clouds(points=cloud.points, normals=-cloud.normals)
    one, other = (record.describe(each, near).values for each in (cloud, turned))
    assert not close(one, other, atol=1e-2)
    assert close(record.unsigned(one), record.unsigned(other), atol=1e-6)


def test_what_does_not_fit_is_refused():
    cloud = sphere_cloud(50)
    near = tr.neighbors(cloud, 0.7, 20)
    with refuses("cloud", "normals", "none"):
        tr.shape_context(tr.Clouds(points=cloud.points), near)
    with refuses("near", "radius", "None"):
        tr.shape_context(cloud, tr.Neighborhoods(near.index, near.valid, near.sq_distance))
    with refuses("frames", "50, 3, 3"):
        tr.shape_context(cloud, near, frames=torch.eye(3)[None])
    with refuses("frames", "finite"):
        tr.shape_context(cloud, near, frames=torch.full((50, 3, 3), float("nan")))
    with refuses("frames", "finite"):
        tr.shape_context(cloud.to(dtype=torch.float32), near, frames=torch.full((50, 3, 3), 1e300, dtype=torch.float64))
    with refuses("inner", "below 1", "1"):
        tr.ShapeContext(radius=1, inner=1.0)
    with refuses("bins", "1", "0"):
        tr.ShapeContext(radius=1, bins=(12, 0, 15))
