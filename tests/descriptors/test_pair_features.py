"""The three angles of a pair, and their bins without an arc tangent, against the textbook."""

import math

import oracles
import pytest
import torch
from closeness import close
from determinism import same_bits
from hypothesis import given
from hypothesis import strategies as st
from problems import random_rotation

from torchreg.descriptors.pair_features import Oriented, angle_bins, compact_pair_features, pair_features, unit_bins

both_kernels = pytest.mark.parametrize("kernel", [pair_features, compact_pair_features])


def oriented(points, normals):
    return Oriented(*points.unbind(-1), *normals.unbind(-1))


def random_pairs(count, seed=0):
    """Points and unit normals (2, count, 3) each."""
    generator = torch.Generator().manual_seed(seed)
    points, normals = torch.randn(2, 2, count, 3, dtype=torch.float64, generator=generator)
    return points, torch.nn.functional.normalize(normals, dim=-1)


def angles(kernel, points, normals):
    """(f1, f2, f3), each (count,)."""
    pair = kernel(oriented(points[0], normals[0]), oriented(points[1], normals[1]))
    return torch.atan2(pair.sine, pair.cosine), pair.f2, pair.f3


def votes(pair):
    """The bins of the three angles."""
    return angle_bins(pair.cosine, pair.sine), unit_bins(pair.f2), unit_bins(pair.f3)


@both_kernels
def test_random_pairs_have_the_angles_of_the_textbook(kernel):
    points, normals = random_pairs(500)
    found = torch.stack(angles(kernel, points, normals), dim=1)
    expected = [
        oracles.pair_angles(*numbers)
        for numbers in zip(*(side[which].tolist() for which in (0, 1) for side in (points, normals)), strict=True)
    ]
    assert close(found, torch.tensor(expected, dtype=torch.float64), atol=1e-9)


@both_kernels
def test_the_direction_of_the_first_angle_is_a_unit_vector_of_its_plane(kernel):
    points, normals = random_pairs(500)
    pair = kernel(oriented(points[0], normals[0]), oriented(points[1], normals[1]))
    # n2 has the coordinates (n1.n2, v.n2, w.n2) in the frame (n1, v, w)
    length = pair.cosine.square() + pair.sine.square() + pair.f2.square()
    assert close(length, torch.ones_like(length), atol=1e-12)


@both_kernels
@pytest.mark.parametrize(
    ("offset", "first", "second"),
    [
        ([0, 0, 0], [0, 0, 1], [1, 0, 0]),  # the same place
        ([0, 0, 2], [0, 0, 1], [0, 0, 1]),  # the line along both normals
        ([0, 0, 2], [0, 0, 1], [1, 0, 0]),  # along the first
        ([0, 0, 2], [1, 0, 0], [0, 0, -1]),  # along the second
        ([0, 0, -3], [0, 0, 1], [0, 0, -1]),
    ],
)
def test_degenerate_pairs_have_three_zeros(kernel, offset, first, second):
    points = torch.tensor([[[0.0, 0, 0]], [offset]], dtype=torch.float64)
    normals = torch.tensor([[first], [second]], dtype=torch.float64)
    assert torch.stack(angles(kernel, points, normals)).tolist() == [[0], [0], [0]]
    assert oracles.pair_angles([0, 0, 0], first, offset, second) == (0, 0, 0)


@both_kernels
def test_a_pair_seen_from_either_side_has_the_same_angles(kernel):
    points, normals = random_pairs(500)
    forth, back = angles(kernel, points, normals), angles(kernel, points.flip(0), normals.flip(0))
    for one, other in zip(forth, back, strict=True):
        assert close(one, other, atol=1e-12)


@both_kernels
@given(seed=st.integers(0, 2**31))
def test_a_rigid_motion_and_a_change_of_unit_leave_the_angles_alone(kernel, seed):
    points, normals = random_pairs(50, seed)
    R = random_rotation(torch.Generator().manual_seed(seed))
    moved = angles(kernel, 7.5 * points @ R.t() + torch.tensor([3.0, -1, 2]), normals @ R.t())
    for one, other in zip(angles(kernel, points, normals), moved, strict=True):
        assert close(one, other, atol=1e-9)


@both_kernels
def test_every_pair_has_its_bits_whatever_stands_beside_it(kernel):
    points, normals = (values.float() for values in random_pairs(1001))
    query, neighbor = oriented(points[0], normals[0]), oriented(points[1], normals[1])
    together = kernel(query, neighbor)
    for cut in (slice(0, 1), slice(3, 10), slice(500, 1001)):
        alone = kernel(Oriented(*(c[cut] for c in query)), Oriented(*(c[cut] for c in neighbor)))
        assert all(same_bits(one, whole[cut]) for one, whole in zip(alone, together, strict=True))


def test_the_compact_kernel_votes_in_float32_as_the_textbook_in_float64():
    points, normals = (values.float() for values in random_pairs(20_000))
    query, neighbor = oriented(points[0], normals[0]), oriented(points[1], normals[1])
    narrow = compact_pair_features(query, neighbor)
    wide = pair_features(*(Oriented(*(column.double() for column in side)) for side in (query, neighbor)))
    assert {column.dtype for column in narrow} == {torch.float32}
    for one, other in zip(votes(narrow), votes(wide), strict=True):
        assert (one != other).float().mean() < 1e-3


def test_rounding_does_not_exchange_almost_parallel_normals():
    # the two cosines differ by some 1e-7; taken the wrong way round, the third angle would change its sign
    generator = torch.Generator().manual_seed(1)
    points, normals = (values.float() for values in random_pairs(5000))
    tilt = 3e-7 * torch.randn(5000, 3, generator=generator)
    normals[1] = normals[0] + tilt
    query, neighbor = oriented(points[0], normals[0]), oriented(points[1], normals[1])
    narrow = compact_pair_features(query, neighbor)
    wide = pair_features(*(Oriented(*(column.double() for column in side)) for side in (query, neighbor)))
    assert (narrow.f3.sign() != wide.f3.sign()).float().mean() < 1e-3
    plain = pair_features(query, neighbor)
    assert (plain.f3.sign() != wide.f3.sign()).float().mean() > 1e-2


@given(st.floats(-math.pi, math.pi), st.floats(1e-3, 1.0))
def test_bins_of_an_angle_are_those_of_the_arc_tangent(angle, length):
    cosine, sine = length * math.cos(angle), length * math.sin(angle)
    position = 11 * (math.atan2(sine, cosine) + math.pi) / (2 * math.pi)
    found = int(angle_bins(torch.tensor([cosine], dtype=torch.float64), torch.tensor([sine], dtype=torch.float64)))
    expected = min(10, math.floor(position))
    close_to_an_edge = abs(position - round(position)) < 1e-9
    assert found == expected or (close_to_an_edge and abs(found - expected) == 1)


def test_bins_of_particular_angles():
    cosine = torch.tensor([1.0, 0, 0, -1, -1, 0, 0, 1])
    sine = torch.tensor([0.0, 1, -1, 0.0, -0.0, 0.0, -0.0, -0.0])
    # atan2 gives 0, pi/2, -pi/2, pi, -pi, 0, 0, 0
    assert angle_bins(cosine, sine).tolist() == [5, 8, 2, 10, 0, 5, 5, 5]


def test_every_angle_bin_is_as_wide():
    angle = (torch.arange(110_000, dtype=torch.float64) + 0.5) / 110_000 * 2 * math.pi - math.pi
    counts = torch.bincount(angle_bins(torch.cos(angle), torch.sin(angle)), minlength=11)
    assert (counts - 10_000).abs().max() <= 1


@given(st.floats(-1, 1))
def test_unit_bins_are_those_of_the_formula(value):
    position = 11 * (value + 1) / 2
    found = int(unit_bins(torch.tensor([value], dtype=torch.float64)))
    assert found == min(10, math.floor(position)) or abs(position - round(position)) < 1e-12


def test_unit_bins_hold_values_pushed_past_the_ends_by_rounding():
    beyond = torch.tensor([-1.0000001, -1.0, 0.0, 1.0, 1.0000001])
    assert unit_bins(beyond).tolist() == [0, 0, 5, 10, 10]


def test_inputs_are_not_written_to():
    value = torch.rand(20, generator=torch.Generator().manual_seed(0))
    before = value.clone()
    unit_bins(value)
    angle_bins(value, value)
    assert torch.equal(value, before)
