"""Probes are rigid, and as far away as they say."""

import math

import pytest
import torch
from closeness import assert_rigid
from problems import random_transform

from torchreg.geometry.se3 import rigid
from torchreg.solvers.poses import pose_vectors
from torchreg.verification.candidates import PointMoments, Poses, distinct, frames, slides, turns
from torchreg.verification.information import weakest_motions

G = torch.Generator().manual_seed(0)
POINTS = torch.rand(500, 3, generator=G) * torch.tensor([6.0, 4.0, 3.0])
NORMALS = torch.nn.functional.normalize(torch.randn(500, 3, generator=G), dim=1)
VALID = (torch.arange(512) < 500)[None]
NONE = torch.zeros(1, dtype=torch.float64)


def filled_up(values):
    """Rows (3, 1, 500) to the length that sums want."""
    return torch.nn.functional.pad(values, (0, 12))


def one_pose():
    T = random_transform(torch.Generator().manual_seed(1)).double()
    zero = torch.zeros(1, dtype=torch.int64)
    return Poses(T[None, :3, :3], T[None, :3, 3], zero, zero)


def moments_of(points):
    """Of points (N, 3) of one scan."""
    wide = points.double()
    apart = wide - wide.mean(dim=0)
    return PointMoments(wide.mean(dim=0)[None], (apart.t() @ apart)[None], torch.tensor([float(len(wide))]).double())


def test_slides_move_the_points_by_their_steps():
    pose = one_pose()
    placed = POINTS.double() @ pose.rotation[0].t() + pose.translation[0]
    normals = (NORMALS @ pose.rotation[0].float().t()).t()[:, None]
    motion = weakest_motions(*(filled_up(values) for values in (placed.t()[:, None], normals)), VALID)
    probes = slides(pose, motion, torch.tensor([0.01], dtype=torch.float64))
    assert_rigid(rigid(probes.rotation, probes.translation))
    moved = POINTS.double() @ probes.rotation.transpose(1, 2) + probes.translation[:, None]
    apart = (moved - placed).square().sum(dim=-1).mean(dim=-1).sqrt()
    assert torch.allclose(apart, torch.tensor([0.16, 0.08, 0.08, 0.16], dtype=torch.float64), rtol=0.02)


def test_turns_are_quarter_and_half_turns_about_the_middle():
    pose = one_pose()
    placed = POINTS.double() @ pose.rotation[0].t() + pose.translation[0]
    probes = turns(pose, moments_of(placed))
    assert_rigid(rigid(probes.rotation, probes.translation))
    turned = probes.rotation @ pose.rotation[0].t()
    traces = torch.diagonal(turned, dim1=1, dim2=2).sum(dim=1).view(3, 3)  # by axis and angle
    assert torch.allclose(traces, torch.tensor([1.0, -1.0, 1.0], dtype=torch.float64).expand(3, 3))
    quarter = turned.view(3, 3, 3, 3)
    assert torch.allclose(quarter[:, 0] @ quarter[:, 0], quarter[:, 1])
    assert torch.allclose(quarter[:, 0] @ quarter[:, 1], quarter[:, 2])
    moved = POINTS.double() @ probes.rotation.transpose(1, 2) + probes.translation[:, None]
    assert torch.allclose(moved.mean(dim=1), placed.mean(dim=0).expand(9, 3))


def test_turns_of_a_slim_body_about_its_axis_are_distinct():
    rod = torch.randn(400, 3, generator=torch.Generator().manual_seed(5)) * torch.tensor([0.01, 0.01, 0.2])
    c, s = 0.0, 1.0
    quarter = torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    eye, zero = torch.eye(3, dtype=torch.float64), torch.zeros(2, dtype=torch.int64)
    poses = Poses(torch.stack([eye, quarter]), torch.zeros(2, 3, dtype=torch.float64), zero, zero)
    kept = distinct(poses.vectors(frames(moments_of(rod), NONE)), zero, torch.tensor([0.06], dtype=torch.float64))
    assert kept == [0, 1]  # though the points move by 0.02


@pytest.mark.parametrize(("degrees", "kept"), [(30, [0]), (60, [0, 1]), (180, [0, 1])])
def test_turns_of_a_body_of_few_points_are_distinct(degrees, kept):
    """A ball as wide as a few thresholds, by which poses are to be 6 apart: no turn moves its points so far."""
    ball = torch.randn(400, 3, generator=torch.Generator().manual_seed(5)) * 0.2
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    turn = torch.tensor([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    eye, zero = torch.eye(3, dtype=torch.float64), torch.zeros(2, dtype=torch.int64)
    poses = Poses(torch.stack([eye, turn]), torch.zeros(2, 3, dtype=torch.float64), zero, zero)
    threshold = torch.tensor([0.1], dtype=torch.float64)
    assert distinct(poses.vectors(frames(moments_of(ball), threshold)), zero, 6 * threshold) == kept


def test_distinct_poses_keep_the_first_of_those_that_are_close():
    pose = one_pose()
    shifts = torch.tensor([0.0, 0.05, 1.0, 1.02, 0.01], dtype=torch.float64)
    many = pose.take(torch.zeros(5, dtype=torch.int64))
    many = many._replace(translation=many.translation + shifts[:, None] * torch.tensor([1.0, 0.0, 0.0]).double())
    vectors = many.vectors(frames(moments_of(POINTS), NONE))
    assert distinct(vectors, many.pair, torch.tensor([0.2], dtype=torch.float64)) == [0, 2]


def test_pairs_do_not_see_each_others_poses():
    pose = one_pose()
    shifts = torch.tensor([0.0, 1.0, 0.05, 0.0, 0.02, 2.0], dtype=torch.float64)
    pair = torch.tensor([0, 0, 0, 2, 2, 2])
    many = pose.take(torch.zeros(6, dtype=torch.int64))._replace(pair=pair)
    many = many._replace(translation=many.translation + shifts[:, None] * torch.tensor([1.0, 0.0, 0.0]).double())
    span = frames(moments_of(POINTS), NONE).expand(3, 4, 3)
    assert distinct(many.vectors(span), pair, torch.tensor([0.2, 9.0, 0.01], dtype=torch.float64)) == [0, 1, 3, 4, 5]


def test_vectors_are_those_of_the_solvers():
    pose = one_pose()
    theirs = pose_vectors(pose.rotation.permute(1, 2, 0), pose.translation.t(), POINTS.double().t())
    span = frames(moments_of(POINTS), NONE)
    assert torch.allclose(pose.vectors(span).square(), theirs.square(), atol=1e-9)
