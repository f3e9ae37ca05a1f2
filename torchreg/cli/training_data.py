"""The pairs of a training: simulated places and listed pairs, parted by scene into trained and held-out ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from torchreg.benchmark.core.real_pairs import RealPair, read_real_pairs
from torchreg.datasets.training_places import simulated_pairs
from torchreg.errors import expect
from torchreg.io import read_cloud
from torchreg.learning.posed_pairs import PosedPair
from torchreg.types.scan_pair import ScanPair

_HELD_OUT_PLACES = 2  # simulated ones of each kind; their seeds begin at 0
_FIRST_TRAINED = 1000  # the seed of the first place to train on
_EVERY = 3  # of the scenes one is held out, where none are named


@dataclass(frozen=True)
class TrainingData:
    """Which pairs are trained on and which are held out.

    Attributes:
        places: simulated places of each kind to train on; with any, others of each kind are held out.
        trained: listed pairs to train on.
        held_out: listed pairs of other scenes.
    """

    places: int
    trained: tuple[RealPair, ...]
    held_out: tuple[RealPair, ...]

    def to_train_on(self) -> Iterator[PosedPair]:
        """The pairs to train on, each read or simulated when it is asked for, and thinned."""
        yield from (_posed(pair).thinned() for pair in self.trained)
        yield from (pair.thinned() for pair in simulated_pairs(_FIRST_TRAINED, self.places))

    @cached_property
    def simulated(self) -> list[PosedPair]:
        """The simulated pairs that are held out."""
        return list(simulated_pairs(0, _HELD_OUT_PLACES if self.places > 0 else 0))

    @property
    def judged(self) -> int:
        """How many pairs are held out."""
        return len(self.held_out) + len(self.simulated)

    def to_judge(self) -> Iterator[PosedPair]:
        """The held-out pairs, each read when it is asked for."""
        yield from map(_posed, self.held_out)
        yield from self.simulated

    def to_validate_on(self) -> list[PosedPair]:
        """The first held-out pair of every group."""
        listed = {pair.scene: pair for pair in reversed(self.held_out)}
        simulated = {pair.group: pair for pair in reversed(self.simulated)}
        return [*map(_posed, listed.values()), *simulated.values()]

    @property
    def held_out_scenes(self) -> list[str]:
        """Names of the listed scenes that are held out."""
        return list(dict.fromkeys(pair.scene for pair in self.held_out))


def training_data(places: int, lists: Sequence[Path], hold_out: Sequence[str] | None) -> TrainingData:
    """Part the pairs by scene.

    Args:
        places: simulated places of each kind to train on.
        lists: of pairs, as ``read_real_pairs`` reads them.
        hold_out: scenes to hold out; ``None``: every third by name, the first among them, where there are several.

    Raises:
        CloudFileError: a list that cannot be read.
        ValueError: nothing to train on, or a scene that no list has.
    """
    listed = [pair for path in lists for pair in read_real_pairs(path)]
    scenes = sorted({pair.scene for pair in listed})
    if hold_out is None:
        hold_out = scenes[::_EVERY] if len(scenes) > 1 else []
    for name in hold_out:
        expect(name in scenes, "--hold-out", f"scenes of the lists: {', '.join(scenes) or 'there are none'}", name)
    trained = tuple(pair for pair in listed if pair.scene not in hold_out)
    some = places > 0 or len(trained) > 0
    expect(some, "--places", "at least 1, or --pairs with scenes that are not held out", places)
    return TrainingData(places, trained, tuple(pair for pair in listed if pair.scene in hold_out))


def _posed(pair: RealPair) -> PosedPair:
    source, target = read_cloud(pair.source), read_cloud(pair.target)
    if source.colors is None or target.colors is None:
        source, target = replace(source, colors=None), replace(target, colors=None)
    return PosedPair(ScanPair(source, target, pair.T_target_source, pair.name), pair.scene, pair.voxel)
