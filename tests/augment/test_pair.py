"""Augmented pairs: the truth stays true, in datasets and in the workers of a loader too."""

import pytest
import torch
from determinism import same_bits
from folders import motion, scene_folder, table_folder
from problems import seeded
from refusals import refuses
from torch.utils.data import DataLoader, Subset

import torchreg as tr
from torchreg import augment
from torchreg.datasets import Fragments, ScanPair, ScanPairs, pack_pairs
from torchreg.geometry.se3 import transform


def everything() -> augment.Compose:
    return augment.Compose(
        augment.RandomMotion(shift=3.0), augment.RandomCrop(), augment.RandomThin(), augment.Illumination(hue=0.1)
    )


def pair_of(seed: int) -> ScanPair:
    """The same points seen from two places: every target point has its source point."""
    draw = seeded(seed)
    source = tr.Clouds(
        torch.rand(150, 3, generator=draw),
        colors=torch.rand(150, 3, generator=draw),
        origin=torch.tensor([[5e5, 4e6, 100.0]], dtype=torch.float64),
    )
    T = motion(seed)
    return ScanPair(source, transform(source, T[None]), T, f"pair-{seed}", torch.eye(6, dtype=torch.float64))


def apart(pair: ScanPair) -> torch.Tensor:
    """How far each source point, moved by the truth, is from the next target point."""
    moved = transform(pair.source, pair.T_target_source[None])
    offset = moved.origin - pair.target.origin
    return torch.cdist(moved.points.double() + offset, pair.target.points.double()).amin(dim=1)


def test_the_truth_stays_true():
    module = augment.AugmentPair(everything())
    for seed in range(5):
        pair = module(pair_of(seed))
        assert isinstance(pair, ScanPair)
        assert pair.name == f"pair-{seed}"
        assert pair.information is None
        assert not torch.allclose(pair.T_target_source, motion(seed), atol=0.1)
        # whatever of the source the target still holds lies on its own point, the rest between neighbors
        share = (apart(pair) < 1e-4).double().mean()
        assert 0.2 < share < 1.0
    exact = augment.AugmentPair(augment.RandomMotion(shift=3.0))(pair_of(1))
    assert apart(exact).max() < 1e-4


def test_a_batch_gives_what_its_pairs_give_one_after_another():
    pairs = [pair_of(seed) for seed in range(3)]
    module = augment.AugmentPair(everything(), generator=seeded(4))
    single = [module(pair) for pair in pairs]
    packed = augment.AugmentPair(everything(), generator=seeded(4))(pack_pairs(pairs))
    assert same_bits(packed, pack_pairs(single))
    assert not same_bits(augment.AugmentPair(everything(), generator=seeded(5))(pack_pairs(pairs)), packed)


def test_source_and_target_change_unlike_and_by_what_they_are_given():
    still = ScanPair(pair_of(0).source, pair_of(0).source, torch.eye(4, dtype=torch.float64), "still")
    both = augment.AugmentPair(augment.RandomMotion())(still)
    assert not torch.allclose(both.T_target_source, still.T_target_source, atol=0.1)
    one = augment.AugmentPair(augment.RandomMotion(), augment.Jitter(sigma=0.0))(still)
    assert same_bits(one.target, still.target)
    assert not torch.allclose(one.T_target_source, still.T_target_source, atol=0.1)


def test_an_unknown_truth_stays_unknown_and_evaluation_changes_nothing():
    pair = pair_of(2)
    unknown = ScanPair(pair.source, pair.target, torch.full((4, 4), float("nan"), dtype=torch.float64), "unknown")
    module = augment.AugmentPair(everything())
    assert not module(unknown).has_truth
    assert module.eval()(pair) is pair


def test_datasets_take_it_as_a_transform(tmp_path):
    table = table_folder(tmp_path, pairs=2)
    plain = ScanPairs(table)
    changed = ScanPairs(table, transform=augment.AugmentPair(everything(), generator=seeded(1)))
    by_hand = augment.AugmentPair(everything(), generator=seeded(1))
    assert same_bits(changed[0], by_hand(plain[0]))
    assert same_bits(changed[1], by_hand(plain[1]))
    scene = scene_folder(tmp_path / "scene")
    fragments = Fragments(scene, transform=augment.AugmentPair(everything(), generator=seeded(1)))
    assert same_bits(fragments[0], augment.AugmentPair(everything(), generator=seeded(1))(Fragments(scene)[0]))


def epochs(table, count: int, *, seed: int = 7, start: str = "fork") -> list[tuple]:
    """The batches of some epochs of one pair four times over, so that only draws tell them apart; two workers."""
    pairs = ScanPairs(table, transform=augment.AugmentPair(everything(), generator=seeded(2)))
    loader = DataLoader(
        Subset(pairs, [0] * 4),
        collate_fn=pack_pairs,
        num_workers=2,
        generator=seeded(seed),
        multiprocessing_context=start,
    )
    return [tuple(loader) for _ in range(count)]


def test_every_worker_has_a_stream_of_its_own_and_runs_repeat(tmp_path):
    table = table_folder(tmp_path, pairs=1)
    first = epochs(table, 2)
    seen = [batch.source.points for epoch in first for batch in epoch]
    assert all(not same_bits(a, b) for k, a in enumerate(seen) for b in seen[:k])  # items, workers, epochs
    assert same_bits(tuple(first), tuple(epochs(table, 2)))
    assert not same_bits(first[0], epochs(table, 1, seed=8)[0])


@pytest.mark.slow
def test_spawned_workers_draw_as_forked_ones(tmp_path):
    table = table_folder(tmp_path, pairs=1)
    assert same_bits(epochs(table, 1, start="spawn")[0], epochs(table, 1)[0])


def test_refusals():
    with refuses("source", "Augmentation"):
        augment.AugmentPair(torch.nn.Identity())
    with refuses("target", "Augmentation"):
        augment.AugmentPair(augment.Jitter(), torch.nn.Identity())
