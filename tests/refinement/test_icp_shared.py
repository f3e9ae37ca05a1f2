"""Many starts on one pair of clouds: the bits of pairs with clouds of their own, each cloud made ready once."""

from importlib import import_module

import pytest
import torch
from determinism import THREADS, same_bits, threads

import torchreg as tr
from torchreg.refinement import IcpLevel, IcpOptions, Pairing, refine_pairs
from torchreg.refinement.correspond import few_nearest
from torchreg.refinement.icp import icp

OPTIONS = {
    "point_to_point": IcpOptions(kind="point_to_point", max_distance=0.3, iterations=6),
    "point_to_plane": IcpOptions(kind="point_to_plane", max_distance=0.3, iterations=6),
    "colored": IcpOptions(kind="colored", max_distance=0.25, iterations=4),
    "levels": IcpOptions(
        kind="point_to_plane",
        levels=(IcpLevel(voxel_size=0.2, max_distance=0.5, iterations=4), IcpLevel(max_distance=0.2, iterations=3)),
    ),
}


@pytest.fixture(scope="module")
def shared(start, perturbed):
    """Three pairs of clouds and six starts: several on the first and the last, one of them hopeless."""
    pairs = [start(seed, count) for seed, count in ((0, 700), (1, 300), (2, 900))]
    source, target = (tr.Clouds.pack([pair[side] for pair in pairs]) for side in range(2))
    which = [0, 2, 0, 1, 2, 0]
    T = torch.cat([perturbed(b, 1.0, 0.03)[None] @ pairs[number].T_start for b, number in enumerate(which)])
    T[4, :3, 3] += 50
    return source, target, Pairing(which, which), T


@pytest.mark.parametrize("name", OPTIONS)
def test_shared_clouds_give_the_same_bits(shared, name):
    source, target, pairing, T = shared
    options = OPTIONS[name]
    together = refine_pairs(source, target, pairing, T, [options] * len(T))
    assert together.reason[4].startswith("no correspondences")
    own = icp(source.select(pairing.source), target.select(pairing.target), T, options)
    assert same_bits(together, own)


@pytest.mark.parametrize("number", THREADS)
def test_threads_that_share_the_pairs_do_not_show(shared, number, monkeypatch):
    source, target, pairing, T = shared
    options = [OPTIONS["point_to_plane"]] * len(T)
    expected = refine_pairs(source, target, pairing, T, options)
    monkeypatch.setattr(import_module("torchreg.refinement.icp"), "_SHARED_POINTS", 0)
    with threads(number):
        assert same_bits(refine_pairs(source, target, pairing, T, options), expected)
        assert torch.get_num_threads() == number


def test_a_target_has_one_tree(shared, monkeypatch):
    source, target, pairing, T = shared
    built = []

    def counted(points):
        built.append(len(points))
        return few_nearest(points)

    monkeypatch.setattr(import_module("torchreg.refinement.levels"), "few_nearest", counted)
    refine_pairs(source, target, pairing, T, [OPTIONS["point_to_plane"]] * len(T))
    assert sorted(built) == sorted(target.lengths)


def test_a_broken_cloud_fails_all_its_pairs(shared):
    source, target, pairing, T = shared
    source = tr.Clouds(points=source.points.clone(), offsets=source.offsets)
    source.points[3] = float("nan")
    result = refine_pairs(source, target, pairing, T, [OPTIONS["point_to_plane"]] * len(T))
    failed = [b for b, reason in enumerate(result.reason) if "not finite" in reason]
    assert failed == [0, 2, 5]
