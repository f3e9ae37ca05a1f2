"""Pairs whose right answer is known: real ones, made harder, and pairs that share nothing.

Right answers: the real pairs, and the same with part of the source cut away, without colors, without viewpoints.
No right answer: clouds of different scenes brought to the same spacing, with and without colors, and the two ends of
one cloud, a gap between them and the source turned at random.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import torch
from common import REAL, listed_pairs
from torch import Tensor

import torchreg as tr
from torchreg.geometry.se3 import rigid

PER_SCENES = 14
"""Pairs of clouds of every two scenes."""


class Case(NamedTuple):
    """One pair: ``kind`` in a word, the scenes it stems from, and its transform, ``None`` where there is none."""

    name: str
    kind: str
    scenes: tuple[str, ...]
    source: tr.Clouds
    target: tr.Clouds
    voxel: float
    truth: Tensor | None


def cases() -> Iterator[Case]:
    """All cases, the same every time."""
    listed = listed_pairs()
    voxels = {pair[side]: pair["voxel_m"] for pair in listed for side in ("source", "target")}
    clouds = {file: tr.voxel_downsample(tr.read_cloud(REAL / file), voxel) for file, voxel in sorted(voxels.items())}
    yield from _overlapping(listed, clouds)
    yield from _strangers(clouds, voxels)
    yield from _ends(clouds, voxels)


def _overlapping(listed: list[dict], clouds: dict[str, tr.Clouds]) -> Iterator[Case]:
    g = torch.Generator().manual_seed(1)
    for pair in listed:
        source, target = clouds[pair["source"]], clouds[pair["target"]]
        truth = torch.tensor(pair["T"], dtype=torch.float64)
        height = _heights(source, torch.randn(3, generator=g))
        cut = _part(source, height > height.quantile(0.4))
        common = {"scenes": (pair["scene"],), "voxel": pair["voxel_m"], "truth": truth}
        yield Case(name=pair["name"], kind="real", source=source, target=target, **common)
        yield Case(name=pair["name"], kind="cut", source=cut, target=target, **common)
        if source.colors is not None:
            yield Case(name=pair["name"], kind="gray", source=_gray(source), target=_gray(target), **common)
        blind = [replace(cloud, viewpoint=None) for cloud in (source, target)]
        yield Case(name=pair["name"], kind="blind", source=blind[0], target=blind[1], **common)


def _strangers(clouds: dict[str, tr.Clouds], voxels: dict[str, float]) -> Iterator[Case]:
    pairs: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for one in clouds:
        for other in clouds:
            scenes = (_scene(one), _scene(other))
            if scenes[0] < scenes[1]:
                pairs.setdefault(scenes, []).append((one, other))
    draw = random.Random(0)
    for scenes, choice in pairs.items():
        for number, (one, other) in enumerate(draw.sample(choice, min(PER_SCENES, len(choice)))):
            source, target = clouds[one], _scaled(clouds[other], voxels[one] / voxels[other])
            if number % 4 == 0 or (source.colors is None) != (target.colors is None):
                source, target = _gray(source), _gray(target)
            yield Case(f"{one} {other}", "strangers", scenes, source, target, voxels[one], None)


def _ends(clouds: dict[str, tr.Clouds], voxels: dict[str, float]) -> Iterator[Case]:
    g = torch.Generator().manual_seed(2)
    for file, cloud in clouds.items():
        centered = cloud.points - cloud.points.mean(dim=0)
        longest = torch.linalg.eigh(centered.t() @ centered).eigenvectors[:, 2]
        height = _heights(cloud, longest)
        source, target = _part(cloud, height < height.quantile(0.4)), _part(cloud, height > height.quantile(0.6))
        turn = torch.linalg.qr(torch.randn(3, 3, generator=g, dtype=torch.float64)).Q
        turn = turn * torch.det(turn)
        moved = tr.transform(source, rigid(turn, torch.zeros(3, dtype=torch.float64)))
        yield Case(file, "two ends", (_scene(file),), moved, target, voxels[file], None)


def _scene(file: str) -> str:
    return file.split("/")[0]


def _heights(cloud: tr.Clouds, direction: Tensor) -> Tensor:
    return (cloud.points - cloud.points.mean(dim=0)) @ direction


def _part(cloud: tr.Clouds, mask: Tensor) -> tr.Clouds:
    rows = mask.nonzero()[:, 0]
    return cloud.rows(rows, torch.tensor([0, len(rows)]))


def _gray(cloud: tr.Clouds) -> tr.Clouds:
    return replace(cloud, colors=None)


def _scaled(cloud: tr.Clouds, factor: float) -> tr.Clouds:
    viewpoint = None if cloud.viewpoint is None else cloud.viewpoint * factor
    return replace(cloud, points=cloud.points * factor, viewpoint=viewpoint)
