"""A verdict depends on its pair alone: not on the batch, the place in it, the group or the number of threads."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import Any, NamedTuple

import pytest
import torch
from determinism import THREADS, same_bits, threads
from problems import random_rotation, room_pair

import torchreg as tr
from torchreg.geometry.se3 import apply_rotation
from torchreg.solvers import PairPoses
from torchreg.types import Clouds, Correspondences, Failure
from torchreg.types.packing import offsets_of
from torchreg.verification import OverlapFeatures, PairLengths, ProposedPoses, WorkPerPair
from torchreg.verification.judge import judge_poses
from torchreg.verification.pairs import groups_of
from torchreg.verification.verdicts import collect

WORK = WorkPerPair(poses=6, sample=1100, refined=2, iterations=5)


NONE = Failure("no consensus", "no consensus")


class Problem(NamedTuple):
    """One pair with two proposals' matches (source and target rows) and poses."""

    source: Clouds
    target: Clouds
    matches: list[tuple[torch.Tensor, torch.Tensor]]
    poses: list[PairPoses]
    lengths: PairLengths
    features: OverlapFeatures = OverlapFeatures()


def poses_of(rotation, translation, matches, failure=None):
    count = len(rotation)
    return PairPoses(
        rotation=rotation,
        translation=translation,
        inliers=torch.ones(count, matches, dtype=torch.bool),
        support=torch.full((count,), matches, dtype=torch.int64),
        error=torch.zeros(count, dtype=torch.float64),
        drawn=9,
        kept=8,
        scored=7,
        failure=failure,
    )


def problem(seed: int, count: int, poses: int = 5, matches: int = 80) -> Problem:
    """Two scans of a room, poses that are right, nearly right and wrong, matches of which half are right."""
    g = torch.Generator().manual_seed(seed)
    pair = room_pair(count, seed=seed)
    source, target = (tr.estimate_normals(cloud, tr.neighbors(cloud, 0.6, 30)) for cloud in (pair.source, pair.target))
    T = pair.T_target_source[0]
    t = T[:3, 3] + apply_rotation(T[:3, :3], source.origin[0]) - target.origin[0]
    parts = []
    for number in range(2):
        rotation = torch.stack([T[:3, :3]] * poses)
        translation = t + 0.1 * torch.randn(poses, 3, dtype=torch.float64, generator=g)
        for row in range(1, poses, 2):
            rotation[row] = random_rotation(g)
        own = torch.randint(len(source.points), (matches - 7 * number,), generator=g)
        moved = apply_rotation(T[:3, :3], source.points[own].double()) + t
        other = torch.cdist(moved, target.points.double()).argmin(dim=1)
        other[::2] = torch.randint(len(target.points), (len(other[::2]),), generator=g)
        parts.append(((own, other), poses_of(rotation, translation, len(own))))
    lengths = PairLengths(threshold=0.2 if count > 500 else 0.4, spacing=0.1)
    features = OverlapFeatures(described(source, g), described(target, g))
    return Problem(source, target, [part[0] for part in parts], [part[1] for part in parts], lengths, features)


def described(cloud: Clouds, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Features that follow from the place, blurred."""
    blur = 0.1 * torch.randn(len(cloud.points), 7, generator=generator)
    rows = torch.nn.functional.normalize(torch.sin(cloud.points @ torch.ones(3, 7)) + blur, dim=1)
    return rows, rows[:, :4].contiguous()


def without_poses(seed: int) -> Problem:
    one = problem(seed, 200)
    none = torch.zeros(0, 3, 3, dtype=torch.float64)
    return one._replace(poses=[poses_of(none, none[:, 0], len(own), NONE) for own, _ in one.matches])


def few_points(seed: int, count: int, flat: bool) -> Problem:
    """Less than anything can be told from: some points, perhaps on a plane, and no matches."""
    g = torch.Generator().manual_seed(seed)
    points = torch.rand(count, 3, generator=g) * torch.tensor([2.0, 3.0, 0.0 if flat else 1.0])
    up = torch.tensor([0.0, 0.0, 1.0]).expand(count, 3)
    cloud = Clouds(points=points, normals=up, colors=torch.full((count, 3), 0.5))
    none = torch.zeros(0, dtype=torch.int64)
    eye = torch.eye(3, dtype=torch.float64)[None]
    poses = poses_of(eye, torch.full((1, 3), 0.01, dtype=torch.float64), 0)
    features = OverlapFeatures(described(cloud, g), described(cloud, g))
    return Problem(cloud, cloud, [(none, none), (none, none)], [poses, poses], PairLengths(0.3, 0.2), features)


def mixed() -> list[Problem]:
    """Of all sizes; pairs without a pose, without viewpoint, and degenerate ones between them."""
    blind = problem(5, 900)
    return [
        problem(0, 1000),
        without_poses(1),
        problem(2, 300, poses=9),
        few_points(3, 5, flat=False),
        problem(4, 2600, poses=2),
        blind._replace(source=replace(blind.source, viewpoint=None)),
        few_points(6, 400, flat=True),
        problem(7, 1000, poses=1, matches=9),
    ]


def gray(problems: list[Problem]) -> list[Problem]:
    return [
        one._replace(
            source=replace(one.source, colors=None),
            target=replace(one.target, colors=None),
            features=OverlapFeatures(*((geometry, None) for geometry, _ in one.features)),
        )
        for one in problems
    ]


def judged(problems: list[Problem]):
    """The verdicts on a batch of these pairs."""
    source, target = (Clouds.pack([one[side] for one in problems]) for side in range(2))
    proposed = []
    for number in range(2):
        rows = [
            [one.matches[number][side] + int(first) for one, first in zip(problems, clouds.offsets[:-1], strict=True)]
            for side, clouds in enumerate((source, target))
        ]
        offsets = offsets_of(len(row) for row in rows[0])
        score = torch.ones(int(offsets[-1]))
        matches = Correspondences(source=torch.cat(rows[0]), target=torch.cat(rows[1]), offsets=offsets, score=score)
        proposed.append(ProposedPoses(f"proposal {number}", matches, [one.poses[number] for one in problems]))
    lengths, features = [one.lengths for one in problems], [one.features for one in problems]
    return collect(source, target, judge_poses(source, target, proposed, lengths, features, WORK))


def of_pair(result, b: int) -> tuple[Any, ...]:
    """Everything that a result says of one pair."""
    begin, end = result.correspondences.offsets[b : b + 2].tolist()
    names = ("T_target_source", "fitness", "inlier_rmse", "success", "probability", "overlap")
    names += ("information", "strength", "runner_up", "margin")
    candidates = [
        tuple(struct.pack("d", value) if isinstance(value, float) else value for value in candidate)  # NaN as it is
        for candidate in result.candidates[b]
    ]
    rows = result.inliers[begin:end].clone(), result.correspondences.score[begin:end].clone()
    return *(getattr(result, name)[b].clone() for name in names), *rows, tuple(candidates), result.reason[b]


def assert_as_alone(result, alone):
    for b, expected in enumerate(alone):
        assert same_bits(of_pair(result, b), expected), f"pair {b}"


@pytest.fixture(scope="module")
def problems():
    return mixed()


@pytest.fixture(scope="module")
def alone(problems):
    return [of_pair(judged([one]), 0) for one in problems]


def test_a_batch_equals_the_loop_over_its_pairs(problems, alone):
    result = judged(problems)
    assert_as_alone(result, alone)
    assert result.reason[1] == "no consensus"
    assert result.candidates[1] == ()
    assert all(len(result.candidates[b]) > 0 for b in range(len(problems)) if b != 1)


def test_the_place_in_a_batch_does_not_show(problems, alone):
    assert_as_alone(judged(problems[::-1]), alone[::-1])
    assert_as_alone(judged([problems[0], *problems]), [alone[0], *alone])


def test_pairs_without_colors_go_together_too(problems):
    bare = gray(problems)
    assert_as_alone(judged(bare), [of_pair(judged([one]), 0) for one in bare])


@pytest.mark.parametrize("elements", [1, 30_000, 1 << 40])
def test_the_size_of_groups_does_not_show(problems, alone, elements, monkeypatch):
    monkeypatch.setattr("torchreg.verification.pairs._ELEMENTS", elements)
    assert_as_alone(judged(problems), alone)


@pytest.mark.parametrize("elements", [1, 1 << 30])
def test_the_size_of_pieces_does_not_show(problems, alone, elements, monkeypatch):
    monkeypatch.setattr("torchreg.verification.evidence._ELEMENTS", elements)
    monkeypatch.setattr("torchreg.verification.agreement._ELEMENTS", elements)
    assert_as_alone(judged(problems), alone)


@pytest.mark.parametrize("number", THREADS)
def test_the_number_of_threads_does_not_show(problems, alone, number):
    with threads(number):
        assert_as_alone(judged(problems), alone)
        assert torch.get_num_threads() == number


def test_the_right_pose_is_chosen(problems):
    result = judged(problems[:1])
    truth = room_pair(1000, seed=0).T_target_source[0]
    assert result.success.tolist() == [True]
    assert float(tr.metrics.rre(truth[None], result.T_target_source)) < 3
    candidates = result.candidates[0]
    assert [each.log_odds for each in candidates] == sorted((each.log_odds for each in candidates), reverse=True)
    assert {each.origin for each in candidates} <= {"proposal 0", "proposal 1", "slide", "turn"}


def test_a_batch_without_any_pose_says_why():
    result = judged([without_poses(0), without_poses(1)])
    assert result.reason == ("no consensus", "no consensus")
    assert not bool(result.success.any())


def test_groups_hold_what_fits_and_large_pairs_go_alone(monkeypatch):
    monkeypatch.setattr("torchreg.verification.pairs._ELEMENTS", 10)
    assert groups_of([4, 0, 5, 3, 11, 10, 2], 1) == ([[0, 2], [3], [5], [6]], [4])
    assert groups_of([2, 2, 2, 2], 2) == ([[0, 1], [2, 3]], [])
    assert groups_of([], 2) == ([], [])
    assert groups_of([0, 0], 2) == ([], [])
