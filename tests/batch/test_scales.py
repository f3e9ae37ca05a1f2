"""One scale for clouds that belong together, and the options that follow."""

import random

import pytest
import torch
from problems import room_pair

import torchreg as tr
from torchreg.batch.clouds import look_at
from torchreg.batch.scales import Scale, options_of, shared_scales
from torchreg.registration.scale import UNEVEN, scaled_options


def random_scales(seed, count=12):
    draw = random.Random(seed)
    own = {k: Scale(draw.choice([0.0, draw.uniform(0.05, 0.3)]), draw.uniform(0.03, 0.3)) for k in range(count)}
    pairs = [(draw.randrange(count), draw.randrange(count)) for _ in range(draw.randrange(3, 20))]
    return own, pairs


@pytest.mark.parametrize("seed", range(30))
def test_nobody_gets_a_finer_scale_than_its_own_nor_one_much_coarser(seed):
    own, pairs = random_scales(seed)
    shared = shared_scales(own, pairs)
    assert shared.keys() == own.keys()
    for cloud, scale in shared.items():
        assert scale.voxel >= own[cloud].voxel
        assert scale.spacing >= own[cloud].spacing
        assert scale.size <= UNEVEN * own[cloud].size * (1 + 1e-12)


@pytest.mark.parametrize("seed", range(30))
def test_the_order_of_clouds_and_pairs_does_not_matter(seed):
    own, pairs = random_scales(seed)
    other = dict(random.Random(seed).sample(list(own.items()), len(own)))
    assert shared_scales(other, [(k, i) for i, k in pairs[::-1]]) == shared_scales(own, pairs)


def test_clouds_that_no_pair_links_keep_their_own():
    own = {"a": Scale(0, 0.10), "b": Scale(0, 0.11), "c": Scale(0, 0.12)}
    assert shared_scales(own, []) == own
    assert shared_scales(own, [("a", "c")]) == {"a": own["c"], "b": own["b"], "c": own["c"]}


def test_what_was_decided_stays_and_others_join_where_they_fit():
    own = {"a": Scale(0, 0.10), "b": Scale(0, 0.11), "c": Scale(0, 0.12), "d": Scale(0, 0.05)}
    kept = {"a": Scale(0, 0.11), "b": Scale(0, 0.11)}
    links = [("a", "b"), ("b", "c"), ("b", "d")]
    shared = shared_scales(own, links, kept)
    assert shared == {**kept, "c": own["c"], "d": own["d"]}
    finer = shared_scales({**own, "c": Scale(0, 0.09)}, links, kept)
    assert finer["c"] == kept["a"]


@pytest.mark.parametrize(("counts", "scale"), [((900, 1000), 1.0), ((300, 3000), 1.0), ((40_000, 500), 3.0)])
def test_a_pair_alone_gets_the_options_that_register_derives(counts, scale):
    clouds = [room_pair(count, seed=k, scale=scale).source for k, count in enumerate(counts)]
    looks = [look_at(cloud, None, scaled=True) for cloud in clouds]
    own = {k: Scale(look.voxel, look.spacing) for k, look in enumerate(looks)}
    shared = shared_scales(own, [(0, 1)])
    expected = tr.derive_options(*clouds)[0]
    found = options_of(shared[0], shared[1], colored=True)
    if expected.voxel_size is None or max(counts) <= 30_000:
        assert found == expected
    else:  # a thinned cloud's spacing is measured on its own voxels
        assert found.voxel_size == expected.voxel_size
        assert found.feature_radius == pytest.approx(expected.feature_radius, rel=0.5)


def test_a_cloud_without_extent_has_options_all_the_same():
    assert options_of(Scale(0, 0), Scale(0, 0), colored=False) == scaled_options(1.0, colored=False)
    look = look_at(tr.Clouds(points=torch.zeros(0, 3)), None, scaled=True)
    assert (look.points, look.voxel, look.spacing) == (0, 0.0, 0.0)
