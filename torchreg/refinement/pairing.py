"""Pairs of clouds, where a cloud may belong to several pairs, and frames of small numbers for them.

A frame has its zero at the mean point of a cloud, without the origin. A transform between files, x_t = R x_s + t,
becomes R, t' between these frames and is turned back at the end, since coordinates of UTM size would cost sums of
products their digits.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import NamedTuple, TypeVar

import torch
from torch import Tensor

from torchreg.geometry.numerics.sums import lane_sums
from torchreg.geometry.se3 import apply_rotation, rigid
from torchreg.types import Clouds
from torchreg.types.packing import spans

Key = TypeVar("Key", bound=Hashable)


class Pairing(NamedTuple):
    """The clouds of B pairs, by their numbers in a batch of sources and in one of targets."""

    source: Sequence[int]  # B numbers
    target: Sequence[int]  # B numbers


def among(source: Clouds, target: Clouds, pairing: Pairing, pairs: Sequence[int]) -> tuple[Clouds, Clouds, Pairing]:
    """The clouds that these pairs need, each once, and their pairing among them."""
    one, source_numbers = _needed(source, [pairing.source[b] for b in pairs])
    other, target_numbers = _needed(target, [pairing.target[b] for b in pairs])
    return one, other, Pairing(source_numbers, target_numbers)


def numbered(keys: Sequence[Key]) -> tuple[list[Key], list[int]]:
    """The different keys, in order of their first places, and the place of every key among them."""
    different = list(dict.fromkeys(keys))
    place = {key: number for number, key in enumerate(different)}
    return different, [place[key] for key in keys]


def _needed(clouds: Clouds, which: Sequence[int]) -> tuple[Clouds, list[int]]:
    different, numbers = numbered(which)
    return (clouds if different == list(range(len(clouds))) else clouds.select(different)), numbers


class Frames(NamedTuple):
    """The zeros of both frames of every pair, (B, 3) float64, meters."""

    source_center: Tensor  # relative to the source's origin: the mean of its points
    target_center: Tensor  # as source_center, of the target
    source_origin: Tensor  # of the clouds
    target_origin: Tensor  # of the clouds

    def of(self, pairs: list[int]) -> Frames:
        """The frames of some of the pairs."""
        return Frames(*(zero[pairs] for zero in self))


def centered_frames(source: Clouds, target: Clouds, pairing: Pairing) -> Frames:
    """The frames of B pairs of finite, not empty clouds."""
    one, other = list(pairing.source), list(pairing.target)
    return Frames(_means(source)[one], _means(target)[other], source.origin[one], target.origin[other])


def enter(frames: Frames, T_target_source: Tensor) -> tuple[Tensor, Tensor]:
    """R (B, 3, 3) and t (B, 3) between the centered frames, from transforms (B, 4, 4) between those of the files."""
    R = T_target_source[:, :3, :3]
    between = T_target_source[:, :3, 3] + apply_rotation(R, frames.source_origin) - frames.target_origin
    return R, between + apply_rotation(R, frames.source_center) - frames.target_center


def leave(frames: Frames, rotation: Tensor, translation: Tensor) -> Tensor:
    """Back from the centered frames to T_target_source (B, 4, 4) between those of the files."""
    between = translation - apply_rotation(rotation, frames.source_center) + frames.target_center
    return rigid(rotation, between - apply_rotation(rotation, frames.source_origin) + frames.target_origin)


def _means(clouds: Clouds) -> Tensor:
    means = [lane_sums(clouds.points[i:j].double(), dim=0) / max(1, j - i) for i, j in spans(clouds.offsets)]
    return torch.stack(means) if means else clouds.origin
