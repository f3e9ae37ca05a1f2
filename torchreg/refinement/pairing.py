"""Which source cloud goes with which target cloud; a cloud may belong to several pairs."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import NamedTuple, TypeVar

from torchreg.types import Clouds

Key = TypeVar("Key", bound=Hashable)


class Pairing(NamedTuple):
    """The clouds of B pairs, by their numbers in a batch of sources and in one of targets.

    Attributes:
        source: B numbers.
        target: B numbers.
    """

    source: Sequence[int]
    target: Sequence[int]


def one_to_one(pairs: int) -> Pairing:
    """Every pair has clouds of its own."""
    return Pairing(range(pairs), range(pairs))


def among(source: Clouds, target: Clouds, pairing: Pairing, pairs: Sequence[int]) -> tuple[Clouds, Clouds, Pairing]:
    """The clouds that these of the pairs need, each once, and the pairing among them."""
    one, source_numbers = _needed(source, [pairing.source[b] for b in pairs])
    other, target_numbers = _needed(target, [pairing.target[b] for b in pairs])
    return one, other, Pairing(source_numbers, target_numbers)


def numbered(keys: Sequence[Key]) -> tuple[list[Key], list[int]]:
    """The different keys, in the order in which they come, and the place of every key among them."""
    different = list(dict.fromkeys(keys))
    place = {key: number for number, key in enumerate(different)}
    return different, [place[key] for key in keys]


def _needed(clouds: Clouds, which: Sequence[int]) -> tuple[Clouds, list[int]]:
    different, numbers = numbered(which)
    return (clouds if different == list(range(len(clouds))) else clouds.select(different)), numbers
