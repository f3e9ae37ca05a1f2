"""Any integer is a seed, and another one draws otherwise."""

from itertools import combinations

import pytest
import torch
from problems import room_pair
from refusals import refuses

import torchreg as tr
from torchreg.learning import TrainingOptions
from torchreg.seeds import any_seed, generator_of, numpy_seed, open3d_seed, torch_seed
from torchreg.settings import Settings

SEEDS = [0, 1, -1, 2**31, 2**32, 2**63 - 1, 2**63, 2**64 - 1, -(2**63), 2**64, 2**100, -(2**100), 10**300]


@pytest.mark.parametrize("of", [torch_seed, numpy_seed, open3d_seed, lambda seed: tuple(
    torch.rand(2, generator=generator_of(seed)).tolist())])  # fmt: skip
def test_seeds_are_distinct_and_repeat(of):
    first = [of(seed) for seed in SEEDS]
    assert len(set(first)) == len(SEEDS)
    assert [of(seed) for seed in SEEDS] == first


@pytest.mark.parametrize("seed", [0, 7, 2**32 - 1])
def test_small_seeds_are_torchs_own(seed):
    assert torch_seed(seed) == numpy_seed(seed) == seed


@pytest.mark.parametrize("seed", [None, 1.5, "1", True, torch.tensor(3)])
def test_what_is_no_integer_is_refused(seed):
    with refuses("seed", "an integer"):
        any_seed(seed)
    with refuses("seed", "an integer"):
        tr.synthetic.match_problem(20, 0.5, seed=seed)


def problem(seed):
    return tr.synthetic.match_problem(20, 0.5, seed=seed).source.points


def place(seed):
    return tr.synthetic.mall(seed, angular_step=5.0).source.points


def street(seed):
    return tr.synthetic.road(seed, angular_step=5.0).source.points


@pytest.mark.parametrize("made", [problem, place, street])
def test_every_integer_makes_a_scene_of_its_own(made):
    scenes = [made(seed) for seed in (1, -1, 2**63, 2**100)]
    assert torch.equal(scenes[1], made(-1))
    assert not any(one.shape == other.shape and torch.equal(one, other) for one, other in combinations(scenes, 2))


def test_every_integer_registers_and_is_another_draw():
    pair = room_pair(600)
    few = tr.RansacOptions(hypotheses=40, inlier_threshold=0.1, local_optimization=0)
    options = tr.RegistrationOptions(
        normal_radius=1.0, descriptors=(tr.Fpfh(radius=1.5, max_neighbors=40),), solver=few
    )
    poses = []
    for seed in (1, -1, 2**63, 2**100):
        found = [tr.register(pair.source, pair.target, options, seed=seed).T_target_source for _ in range(2)]
        assert torch.equal(*found)
        poses.append(found[0])
    assert any(not torch.equal(one, other) for one, other in combinations(poses, 2))


@pytest.mark.parametrize("seed", SEEDS)
def test_settings_and_options_take_every_integer(seed):
    assert Settings(seed=seed).seed == seed
    assert TrainingOptions(seed=seed).seed == seed
