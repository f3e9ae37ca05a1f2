"""Votes that rounding decides are found, and others are not."""

import math

import oracles
import pytest
import torch
from problems import sphere_cloud

import torchreg as tr
from torchreg.reference.ties import KINDS, ROUNDING, Rounding, find_ties


def chain(points, normals):
    """A cloud whose points see each other within 1.5 m, and its neighborhoods."""
    normals = torch.nn.functional.normalize(torch.tensor(normals, dtype=torch.float64), dim=1)
    cloud = tr.Clouds(points=torch.tensor(points, dtype=torch.float64), normals=normals)
    return cloud, tr.neighbors(cloud, 1.5, 4)


def kinds_of_pair(line, first, second, dtype=torch.float64):
    return {tie.kind for tie in find_ties(*chain([[0, 0, 0], line], [first, second]), ROUNDING[dtype]).pairs}


def leaning(cosine, along=1.0):
    """A line whose cosine with the normal z is given."""
    return [along * math.sqrt(1 - cosine * cosine), 0.0, along * cosine]


SIDE = (0.3, 1.0, 0.2)  # a normal that makes no tie with those below


@pytest.mark.parametrize("edge", [1, 2, 9, 10])
def test_a_cosine_on_the_edge_of_a_bin_is_a_tie(edge):
    cosine = 2 * edge / 11 - 1
    assert kinds_of_pair(leaning(cosine), (0, 0, 1), SIDE) == {"edge of f3"}
    assert kinds_of_pair(leaning(cosine + 1e-10), (0, 0, 1), SIDE) == set()
    assert kinds_of_pair(leaning(cosine + 1e-10), (0, 0, 1), SIDE, torch.float32) == {"edge of f3"}


def test_the_ends_of_a_cosine_are_no_edges():
    # n2 = v, so that f2 = 1 (and f1 has no direction, which is a tie of its own)
    assert "edge of f2" not in kinds_of_pair(leaning(0.3), (0, 0, 1), (0, -1, 0))


@pytest.mark.parametrize("odd", [1, 3, 9])
def test_an_angle_on_the_edge_of_a_bin_is_a_tie(odd):
    # the line along x, n1 near it in the plane z = 0, and n2 turned from n1 towards w, which lies in that plane too
    def normal(angle):
        return (math.cos(angle), math.sin(angle), 0.0)

    on_edge = math.pi * odd / 11
    assert kinds_of_pair([1.0, 0, 0], normal(0.02), normal(0.02 + on_edge)) == {"edge of f1"}
    assert kinds_of_pair([1.0, 0, 0], normal(0.02), normal(0.02 + on_edge + 1e-9)) == set()


def test_opposite_normals_are_a_tie_between_the_two_ends_of_the_angle():
    assert kinds_of_pair(leaning(0.3), (0, 0, 1), (0, 0, -1)) == {"edge of f1"}


def test_equal_cosines_are_a_tie_where_the_exchange_matters():
    lean, upright = 0.4, math.sqrt(1 - 0.16)
    line = [1.0, 0.0, 0.0]
    assert kinds_of_pair(line, (lean, upright, 0), (lean, 0, upright)) == {"exchange"}
    # mirrored across the line's middle: either way round the features are the same
    assert kinds_of_pair(line, (lean, upright, 0), (-lean, upright, 0)) == set()


def test_equal_normals_are_no_tie():
    # rounding does the same to both cosines
    assert kinds_of_pair(leaning(0.3), (0.1, 0.2, 0.9), (0.1, 0.2, 0.9)) == set()


def test_nearly_equal_normals_are_no_tie_in_float32():
    # their difference is exact, and with it the comparison of the cosines; not so where they are far apart
    line, close = [1.0, 0.0, 0.0], (0.4 + 1e-6, 0.9, 0.1)
    assert kinds_of_pair(line, (0.4, 0.9, 0.1), close, torch.float32) == set()
    lean, upright = 0.4 + 1e-7, math.sqrt(1 - 0.16)
    assert kinds_of_pair(line, (0.4, upright, 0), (lean, 0, upright)) == set()
    assert kinds_of_pair(line, (0.4, upright, 0), (lean, 0, upright), torch.float32) == {"exchange"}


@pytest.mark.parametrize(
    ("lean", "dtype", "expected"),
    [
        (1e-9, torch.float64, True),
        (1e-5, torch.float64, False),
        (1e-5, torch.float32, True),
        (1e-2, torch.float32, False),
        (0.0, torch.float64, False),
    ],
)
def test_a_line_almost_along_a_normal_is_a_tie(lean, dtype, expected):
    kinds = kinds_of_pair([lean, 0.0, 1.0], (0, 0, 1), SIDE, dtype)
    assert ("line along a normal" in kinds) == expected


def test_points_in_one_place_are_no_tie():
    assert kinds_of_pair([0.0, 0.0, 0.0], (0, 0, 1), (0, 0, -1)) == set()


def test_a_tie_touches_the_rows_that_sum_its_histogram():
    # rows 0 and 1 are tied, 2 sees 1, 3 sees neither
    step = leaning(7 / 11)
    points = [[0, 0, 0], step, [2.1, 0.3, 0.1], [3.3, 0.4, 0.2]]
    ties = find_ties(*chain(points, [(0, 0, 1), SIDE, (0.2, 0.5, 0.8), (-0.4, 0.2, 0.9)]))
    assert {(tie.row, tie.neighbor, tie.kind) for tie in ties.pairs} == {(0, 1, "edge of f3"), (1, 0, "edge of f3")}
    assert ties.touched.tolist() == [True, True, True, False]


def test_edges_are_those_that_loops_find():
    cloud = sphere_cloud(80)
    near = tr.neighbors(cloud, 0.9, 12)
    width = 0.01
    points, normals = cloud.points.tolist(), cloud.normals.tolist()
    expected = set()
    for row, others in enumerate(oracles.neighbor_lists(near)):
        for other, _ in others:
            angles = oracles.pair_angles(points[row], normals[row], points[other], normals[other])
            for which, position in enumerate(oracles.angle_positions(angles)):
                inner = which == 0 or 0 < round(position) < 11
                if inner and abs(position - round(position)) < width:
                    expected.add((row, other, KINDS[which]))
    ties = find_ties(cloud, near, Rounding(width, 0.0, 0.0)).pairs
    found = {tuple(tie) for tie in ties if tie.kind.startswith("edge")}
    assert len(expected) > 20
    assert found == expected


def test_a_cloud_without_normals_is_refused():
    cloud = tr.Clouds(points=torch.rand(5, 3, dtype=torch.float64))
    with pytest.raises(ValueError, match="normals"):
        find_ties(cloud, tr.neighbors(cloud, 1.0, 3))
