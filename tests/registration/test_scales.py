"""One scale for clouds that belong together, and the options that follow."""

import random

import pytest
import torch
from problems import room_pair

import torchreg as tr
from torchreg.batch.clouds import measure
from torchreg.registration.scales import Scale, shared_scales
from torchreg.registration.spacing import UNEVEN


def random_scales(seed, count=12):
    draw = random.Random(seed)
    own = {k: Scale(draw.choice([0.0, draw.uniform(0.05, 0.3)]), draw.uniform(0.03, 0.3)) for k in range(count)}
    pairs = [(draw.randrange(count), draw.randrange(count)) for _ in range(draw.randrange(3, 20))]
    return own, pairs


@pytest.mark.parametrize("seed", range(30))
def test_nobody_gets_a_finer_scale_than_its_own_nor_one_much_coarser(seed):
    own, pairs = random_scales(seed)
    for cloud, scale in shared_scales(own, pairs).items():
        assert scale.voxel >= own[cloud].voxel
        assert scale.spacing >= own[cloud].spacing
        assert scale.size <= UNEVEN * own[cloud].size * (1 + 1e-12)


@pytest.mark.parametrize("seed", range(30))
def test_the_order_of_clouds_and_pairs_does_not_matter(seed):
    own, pairs = random_scales(seed)
    other = dict(random.Random(seed).sample(list(own.items()), len(own)))
    assert shared_scales(other, [(k, i) for i, k in pairs[::-1]]) == shared_scales(own, pairs)


def test_clouds_of_one_partner_at_most_keep_their_own():
    own = {"a": Scale(0, 0.10), "b": Scale(0, 0.11), "c": Scale(0, 0.12)}
    assert shared_scales(own, []) == {}
    assert shared_scales(own, [("a", "c"), ("c", "a")]) == {}
    assert shared_scales(own, [("a", "c"), ("c", "b")]) == dict.fromkeys("abc", own["c"])


@pytest.mark.parametrize(
    "points", [torch.zeros(0, 3), torch.full((9, 3), float("nan")), torch.ones(9, 3), torch.full((9, 3), 1e20)]
)
@pytest.mark.parametrize("voxel", [None, 0.1, 1e-9])
def test_a_cloud_that_will_be_refused_can_be_measured(points, voxel):
    measures = measure(tr.Clouds(points=points), voxel, scaled=True)
    assert (measures.points, measures.spacing) == (len(points), 0.0)


def test_a_voxel_that_is_too_small_is_no_error_of_measuring():
    assert measure(room_pair(300).source, 1e-9, scaled=True).spacing == 0.0
