"""What holds for every descriptor: order and unit do not matter, and nothing but the neighborhood shows."""

from dataclasses import replace

import pytest
import torch
from closeness import close
from determinism import assert_batch_equals_loop, assert_nothing_shows, pieces, same_bits
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import garbage_in_invalid_slots, oriented_room, random_transform, sphere_cloud

import torchreg as tr

CHANNELS = ("hue", "saturation", "value")
DESCRIPTORS = {
    "fpfh": lambda cloud, near, radius: tr.fpfh(cloud, near),
    "pcfh": lambda cloud, near, radius: tr.pcfh(cloud, near),
    "pcfh of all channels": lambda cloud, near, radius: tr.pcfh(cloud, near, channels=CHANNELS),
    "pcfh by saturation": lambda cloud, near, radius: tr.pcfh(
        cloud, near, channels=CHANNELS, saturation_weighting=True
    ),
    "contrast": tr.contrast,
    "pfh": lambda cloud, near, radius: tr.pfh(cloud, near),
    "pfhrgb": lambda cloud, near, radius: tr.pfhrgb(cloud, near),
    "spin images": lambda cloud, near, radius: tr.spin_images(cloud, near),
    "radial spin images of angles": lambda cloud, near, radius: tr.spin_images(
        cloud, near, support_cosine=0.7, structure="radial", content="angles"
    ),
    # in 1 / m
    "shape context": lambda cloud, near, radius: scaled(tr.shape_context(cloud, near), radius),
}


def scaled(features, factor):
    return replace(features, values=features.values * factor)


every_descriptor = pytest.mark.parametrize("describe", DESCRIPTORS.values(), ids=DESCRIPTORS)


def described(describe, cloud, radius=0.6, max_neighbors=60):
    return describe(cloud, tr.neighbors(cloud, radius, max_neighbors), radius)


@every_descriptor
def test_a_change_of_unit_changes_nothing(describe):
    cloud = sphere_cloud(150)
    feet = tr.Clouds(points=3.25 * cloud.points, colors=cloud.colors, normals=cloud.normals)
    expected = described(describe, cloud).values
    assert close(described(describe, feet, radius=0.6 * 3.25).values, expected, atol=1e-9)


@every_descriptor
def test_a_rigid_motion_changes_nothing(describe):
    cloud = sphere_cloud(200)
    moved = tr.transform(cloud, random_transform(torch.Generator().manual_seed(1)))
    assert close(described(describe, moved).values, described(describe, cloud).values, atol=1e-8)


@every_descriptor
@settings(max_examples=10)
@given(seed=st.integers(0, 2**31))
def test_a_permutation_of_points_permutes_the_rows(describe, seed):
    cloud = sphere_cloud(150)
    order = torch.randperm(150, generator=torch.Generator().manual_seed(seed))
    expected = described(describe, cloud).values[order]
    assert close(described(describe, cloud.rows(order, cloud.offsets)).values, expected, atol=1e-9)


@every_descriptor
def test_garbage_in_invalid_slots_changes_nothing(describe):
    cloud, near = oriented_room()
    assert not near.valid.all()
    assert same_bits(describe(cloud, near, 1.0), describe(cloud, garbage_in_invalid_slots(near), 1.0))


@every_descriptor
def test_a_batch_equals_the_loop_over_its_clouds(describe):
    def run(clouds):
        features = described(describe, clouds, radius=0.8, max_neighbors=40)
        return features.values, features.valid

    assert_batch_equals_loop(run, [oriented_room(count, seed)[0] for seed, count in enumerate((300, 500, 40))])


@every_descriptor
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_neither_threads_nor_pieces_change_a_bit(describe, dtype):
    cloud, near = oriented_room(2500, dtype=dtype)
    assert_nothing_shows(lambda: describe(cloud, near, 1.0))


@every_descriptor
def test_one_row_at_a_time_gives_the_same_bits(describe):
    cloud, near = oriented_room(150)
    expected = describe(cloud, near, 1.0)
    with pieces(1):
        assert same_bits(describe(cloud, near, 1.0), expected)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
@every_descriptor
def test_halves_are_described_in_single_precision(describe, dtype):
    cloud = sphere_cloud(150).to(dtype=torch.float32)
    near = tr.neighbors(cloud, 0.6, 60)
    half = cloud.to(dtype=dtype)
    features = describe(half, near, 0.6)
    assert features.values.dtype == torch.float32
    assert torch.isfinite(features.values).all()
    assert same_bits(features, describe(half.to(dtype=torch.float32), near, 0.6))
