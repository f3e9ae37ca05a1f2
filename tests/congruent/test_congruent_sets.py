"""Bases, pairs and congruent sets, each against what defines it."""

import math
from itertools import permutations, product

import pytest
import torch
from problems import numbers, random_points, seeded, turned

from torchreg.congruent.bases import Bases, draw_bases
from torchreg.congruent.pairs import found_pairs, pair_table, rarest
from torchreg.congruent.poses import CommonPoints, ScoredPoses
from torchreg.congruent.sets import congruent_sets
from torchreg.congruent.sides import CloudSide, Tolerances, cross, dot, side_of, unit
from torchreg.types import Clouds

WIDE = Tolerances(meters=0.03, normals=math.pi, colors=math.inf, signed=True)


def side(count, seed=0):
    """Points in a cube of 1 m with random normals and colors."""
    normals = torch.nn.functional.normalize(numbers(count, 3, seed=seed), dim=1).float()
    return side_of(Clouds(points=random_points(count, seed), normals=normals, colors=random_points(count, seed + 1)))


def moved(one):
    """The same cloud turned and shifted, its points about a middle of their own."""
    T = turned(77, (0.3, 1.0, -0.4), (4.0, -2.0, 1.0)).float()
    cloud = Clouds(
        points=one.points.t() @ T[:3, :3].t() + T[:3, 3],
        normals=one.normals.t() @ T[:3, :3].t(),
        colors=one.colors.t().contiguous(),
    )
    return side_of(cloud)


def test_bases_are_flat_within_their_width_and_their_diagonals_cross_in_the_ratios():
    one = side(400)
    bases = draw_bases(one, 50, 0.6, 0.02, seeded())
    corners = one.points[:, bases.corners]  # (3, 4, B)
    assert corners.shape[2] > 10
    for i, j in product(range(4), repeat=2):
        length = (corners[:, i] - corners[:, j]).norm(dim=0)
        assert bool((length <= 0.6 + 1e-6).all())
        assert i == j or bool((length >= 0.2 * 0.6 - 1e-6).all())
    crossings = [
        corners[:, k] + ratio * (corners[:, k + 1] - corners[:, k])
        for k, ratio in zip((0, 2), bases.ratios, strict=True)
    ]
    assert bool(((bases.ratios > 0) & (bases.ratios < 1)).all())
    # no farther apart than the fourth point is from the plane of the other three, but for the angle between diagonals
    assert float((crossings[0] - crossings[1]).norm(dim=0).median()) < 0.02
    normal = unit(cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    assert float(dot(normal, corners[:, 3] - corners[:, 0]).abs().median()) < 0.03


def test_the_same_generator_draws_the_same_bases():
    one = side(300)
    first, again = (draw_bases(one, 40, 0.5, 0.02, seeded(3)) for _ in range(2))
    assert torch.equal(first.corners, again.corners)
    assert torch.equal(first.ratios, again.ratios)
    assert not torch.equal(first.corners, draw_bases(one, 40, 0.5, 0.02, seeded(4)).corners)


@pytest.mark.parametrize("signed", [True, False])
@pytest.mark.parametrize("normals", [math.pi, 0.9, 0.4])
def test_pairs_are_those_of_a_loop_over_all_of_them(normals, signed):
    one, other = side(40), side(24, seed=5)
    bases = draw_bases(one, 6, 0.9, 0.1, seeded())
    within = Tolerances(meters=0.05, normals=normals, colors=0.8, signed=signed)
    found = found_pairs(pair_table(other, 0.0, 2.0), one, other, bases, 0, within)
    got = set(zip(found.base.tolist(), found.first.tolist(), found.second.tolist(), strict=True))
    slacks = [2 * math.sin(min(share * normals, math.pi) / 2) for share in (1, 1, 2)]
    wanted = set()
    for base, (a, b) in enumerate(bases.corners[:2].t().tolist()):
        length, angles = described(one, a, b)
        for i, j in permutations(range(24), 2):
            apart, theirs = described(other, i, j)
            fits = abs(apart - length) <= 0.05
            if normals < math.pi:
                both = zip(angles, theirs, slacks, strict=True)
                fits &= all(abs(x - y) <= slack if signed else abs(abs(x) - abs(y)) <= slack for x, y, slack in both)
            fits &= all(float((one.colors[:, x] - other.colors[:, y]).norm()) <= 0.8 for x, y in ((a, i), (b, j)))
            if fits:
                wanted.add((base, i, j))
    assert got == wanted
    assert len(wanted) > 0
    assert len(got) == len(found.base)


@pytest.mark.parametrize("degrees", [10.0, 25.0, 80.0, 130.0])
@pytest.mark.parametrize("signed", [True, False])
def test_no_pair_is_lost_whose_normals_are_each_within_the_angle(degrees, signed):
    one, angle = side(60), math.radians(degrees)
    bases = draw_bases(one, 40, 0.9, 0.1, seeded())
    a, b = bases.corners[:2]
    for seed in range(8):
        axis = unit(cross(one.normals, numbers(3, 60, seed=seed).float()))  # across the normals, each off by all of it
        off = one.normals * math.cos(angle) + cross(axis, one.normals) * math.sin(angle)
        other = one._replace(normals=off if signed else off * numbers(60, seed=9).sign().float())
        within = WIDE._replace(normals=angle * (1 + 1e-4), signed=signed)
        found = found_pairs(pair_table(other, 0.0, 2.0), one, other, bases, 0, within)
        got = set(zip(found.base.tolist(), found.first.tolist(), found.second.tolist(), strict=True))
        assert got >= set(zip(range(len(a)), a.tolist(), b.tolist(), strict=True))


@pytest.mark.parametrize("signed", [True, False])
def test_normals_that_are_left_out_change_no_score(signed):
    one, within = side(200), WIDE._replace(signed=signed)
    eye = ScoredPoses(
        torch.eye(3, dtype=torch.float64)[..., None], torch.full((3, 1), 0.01).double(), torch.zeros(1).double()
    )
    others = [one.normals, -one.normals, side(200, seed=9).normals, None]
    scores, strict = (
        [float(CommonPoints(one, one._replace(normals=each), limits).exactly(eye).score) for each in others]
        for limits in (within, within._replace(normals=0.5))
    )
    assert scores[0] > 0
    assert len(set(scores)) == 1
    assert strict[2] < scores[2]


def described(one, i, j):
    """The distance of two points, and the cosines of their normals with the way between them and with each other."""
    way = one.points[:, j] - one.points[:, i]
    n, m = one.normals[:, i], one.normals[:, j]
    return float(way.norm()), [float(n @ way / way.norm()), float(m @ way / way.norm()), float(n @ m)]


def test_rarest_bases_have_no_more_pairs_than_those_left_out():
    one, other = side(150), side(150, seed=2)
    within = WIDE._replace(normals=0.5)
    table = pair_table(other, 0.0, 2.0)
    bases = draw_bases(one, 60, 0.6, 0.05, seeded())
    chosen = rarest(table, one, other, bases, within, 15)
    pairs = [
        sum(len(found_pairs(table, one, other, each, k, within).base) for k in range(2)) for each in (chosen, bases)
    ]
    assert chosen.corners.shape[1] == 15
    assert pairs[0] / 15 < pairs[1] / bases.corners.shape[1]


def test_sets_are_those_of_a_loop_over_all_pairs_of_pairs():
    one = side(24)
    other = moved(one)
    bases = draw_bases(one, 6, 1.0, 0.1, seeded())
    table = pair_table(other, 0.0, 2.0)
    pairs = tuple(found_pairs(table, one, other, bases, k, WIDE) for k in range(2))
    parts = list(congruent_sets(one, other, bases, pairs, WIDE.meters))
    got = {
        (base, *corners)
        for part in parts
        for base, corners in zip(part.base.tolist(), part.corners.t().tolist(), strict=True)
    }
    wanted = set()
    lists = [list(zip(*(column.tolist() for column in each), strict=True)) for each in pairs]
    for (base, i, j), (again, m, n) in product(*lists):
        if base == again and congruent(one, other, bases, base, (i, j, m, n)):
            wanted.add((base, i, j, m, n))
    assert got == wanted
    assert sum(len(part.base) for part in parts) == len(got)


def listed(parts):
    """Every set as its base and its corners."""
    return {
        (base, *corners)
        for part in parts
        for base, corners in zip(part.base.tolist(), part.corners.t().tolist(), strict=True)
    }


def congruent(one, other, bases, base, corners):
    """Whether crossings of diagonals meet and sides are as long as those of the base."""
    mine, theirs = one.points[:, bases.corners[:, base]], other.points[:, list(corners)]
    r, s = bases.ratios[:, base]
    gap = theirs[:, 0] + r * (theirs[:, 1] - theirs[:, 0]) - theirs[:, 2] - s * (theirs[:, 3] - theirs[:, 2])
    sides = [
        float(((theirs[:, a] - theirs[:, b]).norm() - (mine[:, a] - mine[:, b]).norm()).abs())
        for a, b in ((0, 2), (0, 3), (1, 2), (1, 3))
    ]
    return float(gap.norm()) <= WIDE.meters and max(sides) <= WIDE.meters


def test_a_base_of_a_moved_cloud_is_found_where_it_went():
    one = side(300)
    other = moved(one)
    bases = draw_bases(one, 30, 0.6, 0.01, seeded())
    within = Tolerances(meters=0.02, normals=0.2, colors=0.1, signed=True)
    table = pair_table(other, 0.0, 2.0)
    pairs = tuple(found_pairs(table, one, other, bases, k, within) for k in range(2))
    got = listed(congruent_sets(one, other, bases, pairs, within.meters))
    flat = crossing_gaps(one, bases) <= within.meters  # a base of crossings apart by more is not congruent to itself
    assert int(flat.sum()) > 10
    for base in flat.nonzero()[:, 0].tolist():
        assert (base, *bases.corners[:, base].tolist()) in got


def crossing_gaps(one: CloudSide, bases: Bases) -> torch.Tensor:
    a, b, c, d = one.points[:, bases.corners].unbind(dim=1)
    r, s = bases.ratios
    return (a + r * (b - a) - c - s * (d - c)).norm(dim=0)
