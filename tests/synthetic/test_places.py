"""Properties of every simulated place: types and frames, a rigid truth, the same bits for a seed, refusals."""

import math

import numpy as np
import pytest
import torch
from determinism import same_bits
from scans import colors_of, in_target, nearest

from torchreg.datasets import mall, road

every_place = pytest.mark.parametrize("place", [mall, road])


@every_place
def test_types_and_frames(place):
    pair = place(0, angular_step=1.0)
    for cloud in (pair.source, pair.target):
        assert len(cloud) == 1
        assert cloud.points.dtype == colors_of(cloud).dtype == torch.float32
        assert torch.equal(cloud.origin, torch.zeros(1, 3, dtype=torch.float64))
        assert torch.equal(cloud.viewpoint, torch.zeros(1, 3))
        assert colors_of(cloud).min() >= 0
        assert colors_of(cloud).max() <= 1
        levels = 255 * colors_of(cloud)
        assert (levels - levels.round()).abs().max() < 1e-3  # 8 bits
        assert cloud.points.norm(dim=1).max() < 80.5
    assert pair.name == f"{place.__name__}-0"


@every_place
def test_same_seed_same_bits_and_other_seed_another_place(place):
    pair, other = place(0, angular_step=1.0), place(1, angular_step=1.0)
    assert same_bits(pair, place(0, angular_step=1.0))
    assert pair.source.lengths != other.source.lengths
    assert not torch.equal(pair.T_target_source, other.T_target_source)


@every_place
def test_global_random_state_is_left_alone(place):
    np.random.seed(5)
    torch.manual_seed(5)
    expected = np.random.random(3), torch.rand(3)
    np.random.seed(5)
    torch.manual_seed(5)
    place(2, angular_step=5.0)
    assert (np.random.random(3) == expected[0]).all()
    assert torch.equal(torch.rand(3), expected[1])


@pytest.mark.parametrize(("place", "baseline"), [(mall, 6.0), (mall, 2.5), (road, 6.0), (road, 25.0)])
def test_truth_is_a_rigid_motion_over_the_baseline(place, baseline):
    T = place(0, baseline=baseline, angular_step=5.0).T_target_source
    assert torch.allclose(T[:3, :3] @ T[:3, :3].T, torch.eye(3, dtype=torch.float64), atol=1e-12)
    assert torch.linalg.det(T[:3, :3]) == pytest.approx(1)
    assert T[:3, 3].norm().item() == pytest.approx(baseline)
    assert 0 < math.degrees(math.acos(T[2, 2].item())) < 4  # two scanners, less than 2 degrees each


@every_place
def test_one_place_can_be_scanned_twice(place):
    """The scanner turns between the scans; what only one of them sees has moved or is hidden by what has."""
    scans = place(0, baseline=0.0, angular_step=0.7)
    T = scans.T_target_source
    assert torch.equal(T[:3, 3], torch.zeros(3, dtype=torch.float64)) or T[:3, 3].norm() < 1e-12
    assert math.acos(((T[:3, :3].trace() - 1) / 2).item()) > 0.01
    moved = in_target(scans)
    close = np.linalg.norm(moved, axis=1) < 8
    apart = nearest(moved[close], scans.target.points.numpy())[1]
    assert 0.002 < (apart > 0.2).mean() < 0.2


@every_place
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": 1.5}, "seed: expected an integer, got 1.5"),
        ({"baseline": -0.1}, r"baseline: expected meters in \[0, (16|30)\], got -0.1"),
        ({"baseline": 31}, r"baseline: expected meters in \[0, (16|30)\], got 31"),
        ({"angular_step": 0.0}, "angular_step: expected"),
        ({"angular_step": float("nan")}, "angular_step: expected degrees .* got nan"),
        ({"range_noise": -0.001}, "range_noise: expected"),
        ({"range_noise": float("nan")}, "range_noise: expected"),
        ({"relight": 3}, "relight: expected"),
        ({"relight": "sunny"}, "relight: expected a number, got 'sunny'"),
    ],
)
def test_bad_arguments(place, options, message):
    with pytest.raises(ValueError, match=message):
        place(**options)


def test_the_longest_baselines():
    with pytest.raises(ValueError, match=r"baseline: expected meters in \[0, 16\], got 20.0"):
        mall(baseline=20.0)
    with pytest.raises(ValueError, match=r"baseline: expected meters in \[0, 30\], got 31"):
        road(baseline=31)
