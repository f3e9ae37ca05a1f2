"""PFH and PFHRGB: plain loops over pairs say the same, degenerate pairs count, and signs of normals fold."""

from collections import Counter

import oracles
import pytest
import torch
from closeness import close
from determinism import pieces, same_bits
from problems import oriented_room, sphere_cloud
from refusals import refuses

import torchreg as tr
from torchreg.descriptors.neighbor_pairs import pair_pieces
from torchreg.geometry.numerics.chunks import CACHE_ELEMENTS

BOTH = [tr.pfh, tr.pfhrgb]


def five(position):
    return min(4, max(0, int(5 * position // 1)))


def pfh_of(cloud, slots):
    """PFH of one neighborhood, from all pairs of its points."""
    found = Counter()
    points, normals = cloud.points.tolist(), cloud.normals.tolist()
    for place, one in enumerate(slots):
        for other in slots[:place]:
            angles = oracles.pair_angles(points[one], normals[one], points[other], normals[other])
            f1, f2, f3 = (five(position / 11) for position in oracles.angle_positions(angles))
            found[f1 + 5 * f2 + 25 * f3] += 1
    pairs = max(1, len(slots) * (len(slots) - 1) // 2)
    return torch.tensor([100 * found[cell] / pairs for cell in range(125)], dtype=torch.float64)


def color_half_of(cloud, slots):
    """The color half of PFHRGB of one neighborhood, from all ordered pairs of its points."""
    found = Counter()
    for one in slots:
        for other in slots:
            if one != other:
                ratios = [
                    ratio(*both) for both in zip(cloud.colors[one].tolist(), cloud.colors[other].tolist(), strict=True)
                ]
                red, green, blue = (five((value + 1) / 2) for value in ratios)
                found[red + 5 * green + 25 * blue] += 1
    pairs = max(1, len(slots) * (len(slots) - 1) // 2)
    return torch.tensor([100 * found[cell] / pairs for cell in range(125)], dtype=torch.float64)


def ratio(first, second):
    if second == 0:
        return 1.0
    return first / second if first <= second else -second / first


def slots_of(near, row):
    return near.index[row][near.valid[row]].tolist()


def test_pfh_is_that_of_plain_loops():
    cloud = sphere_cloud(90, seed=3)
    near = tr.neighbors(cloud, 0.8, 20)
    found = tr.pfh(cloud, near)
    assert found.blocks == (("pfh", 125),)
    for row in range(0, 90, 7):
        assert close(found.values[row], pfh_of(cloud, slots_of(near, row)), atol=1e-4)


def test_color_ratios_are_those_of_plain_loops():
    cloud = sphere_cloud(90, seed=3)
    colors = cloud.colors.clone()
    colors[::5, 0] = 0
    colors[::7] = 0
    cloud = tr.Clouds(points=cloud.points, normals=cloud.normals, colors=colors)
    near = tr.neighbors(cloud, 0.8, 20)
    found = tr.pfhrgb(cloud, near)
    assert found.blocks == (("pfhrgb", 250),)
    for row in range(0, 90, 7):
        assert close(found.values[row, 125:], color_half_of(cloud, slots_of(near, row)), atol=1e-4)


@pytest.mark.parametrize("describe", BOTH)
def test_every_half_keeps_its_sum(describe):
    cloud, near = oriented_room(400)
    features = describe(cloud, near)
    sums = features.values.view(len(near), -1, 125).sum(dim=2)[features.valid]
    assert torch.allclose(sums, torch.tensor(100.0 if describe is tr.pfh else 200.0), rtol=1e-5)


@pytest.mark.parametrize("describe", BOTH)
def test_a_point_alone_is_not_valid(describe):
    points = torch.tensor([[0.0, 0, 0], [0.1, 0, 0], [9.0, 9, 9]])
    up = torch.tensor([0.0, 0, 1]).expand(3, 3)
    cloud = tr.Clouds(points=points, normals=up, colors=points / 9)
    features = describe(cloud, tr.neighbors(cloud, 1.0, 3))
    assert features.valid.tolist() == [True, True, False]
    assert not features.values[2].any()


@pytest.mark.parametrize("describe", BOTH)
def test_points_in_one_place_have_angles_of_zero(describe):
    cloud = tr.Clouds(points=torch.ones(4, 3), normals=torch.eye(3)[[0, 1, 2, 0]], colors=torch.full((4, 3), 0.5))
    values = describe(cloud, tr.neighbors(cloud, 1.0, 4)).values
    assert close(values[:, 62], torch.full((4,), 100.0 if describe is tr.pfh else 200.0), atol=1e-4)
    if describe is tr.pfhrgb:
        assert close(values[:, 249], torch.full((4,), 200.0), atol=1e-4)  # equal colors: ratios of 1


def test_a_brighter_light_leaves_color_ratios():
    cloud = sphere_cloud(100)
    near = tr.neighbors(cloud, 0.7, 30)
    dim = tr.Clouds(points=cloud.points, normals=cloud.normals, colors=cloud.colors / 2)
    assert same_bits(tr.pfhrgb(cloud, near).values, tr.pfhrgb(dim, near).values)


@pytest.mark.parametrize("kind", [tr.Pfh, tr.PfhRgb])
def test_what_is_unsigned_does_not_know_the_sign_of_normals(kind):
    cloud = sphere_cloud(200)
    record, near = kind(radius=0.6), tr.neighbors(cloud, 0.6, 40)
    turned = tr.Clouds(points=cloud.points, normals=-cloud.normals, colors=cloud.colors)
    one, other = (record.describe(each, near).values for each in (cloud, turned))
    assert not close(one, other, atol=1.0)
    # where a number lies on the edge of a bin, its mirror image lies on it too
    assert close(record.unsigned(one), record.unsigned(other), atol=1e-6)


@pytest.mark.parametrize("describe", BOTH)
def test_what_does_not_fit_is_refused(describe):
    cloud = sphere_cloud(50)
    near = tr.neighbors(cloud, 0.7, 20)
    with refuses("cloud", "normals", "none"):
        describe(tr.Clouds(points=cloud.points, colors=cloud.colors), near)
    with refuses("bandwidth", "hard binning"):
        describe(cloud, near, bandwidth=0.5)
    with refuses("near", "50 points", "49"):
        describe(cloud, near.of_rows(0, 49))
    broken = cloud.normals.clone()
    broken[3, 1] = float("nan")
    with refuses("normals", "finite"):
        describe(tr.Clouds(points=cloud.points, colors=cloud.colors, normals=broken), near)


def test_colors_are_needed():
    cloud = sphere_cloud(50)
    near = tr.neighbors(cloud, 0.7, 20)
    with refuses("cloud", "colors", "none"):
        tr.pfhrgb(tr.Clouds(points=cloud.points, normals=cloud.normals), near)


def test_a_row_of_many_pairs_is_cut():
    near = tr.neighbors(sphere_cloud(600, seed=1), 3.0, 600)
    near = near.of_rows(0, 3)
    slot = torch.arange(600.0)
    found = [[] for _ in range(3)]
    for piece in pair_pieces(near, [slot]):
        assert piece.valid.numel() <= CACHE_ELEMENTS
        for row, one, other in zip(range(3)[piece.rows], piece.first[0], piece.second[0], strict=True):
            found[row].append(one.long() * 600 + other.long())
    later, earlier = torch.tril_indices(600, 600, -1)
    for row, each in enumerate(found):
        assert torch.equal(torch.cat(each), near.index[row][later] * 600 + near.index[row][earlier])


@pytest.mark.parametrize("describe", BOTH)
def test_cuts_of_rows_show_in_no_bit(describe):
    cloud = sphere_cloud(14, seed=1)
    near = tr.neighbors(cloud, 3.0, 14)
    expected = describe(cloud, near)
    for elements in (1, 20, 100):
        with pieces(elements):
            assert same_bits(describe(cloud, near), expected)
