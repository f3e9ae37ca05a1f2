"""Pairs whose right answer is known: real ones, made harder, and pairs that share nothing.

Right answers: the real pairs, and the same with viewpoints that are only assumed; half of them with part of the source
cut away, the others without colors; simulated halls and roads. No right answer: clouds of different scenes brought to
the same spacing, with and without colors; the two ends of one cloud, a gap between them and the source turned at
random. Either: rooms from two stations, and pairs that are made to deceive.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import replace
from importlib.util import module_from_spec, spec_from_file_location
from itertools import combinations
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
import torch
from common import HARD, MADE, REAL, listed_pairs
from torch import Tensor

import torchreg as tr
from torchreg.geometry.se3 import rigid

PER_SCENES = 1
"""Pairs of clouds of every two scenes."""

PER_KIND, ROOMS, SIMULATED, FIRST_SEED = 6, 12, 6, 500
"""Made pairs of each kind, rooms, simulated pairs of each kind, and the first seed of all."""

NO_SCANNER = ("stanford_bunny",)
"""Scenes whose zero is not the scanner."""


class Case(NamedTuple):
    """One pair: ``kind`` in a word, the scenes it stems from, and its transform, ``None`` where there is none."""

    name: str
    kind: str
    scenes: tuple[str, ...]
    source: tr.Clouds
    target: tr.Clouds
    voxel: float | None
    truth: Tensor | None


def cases() -> Iterator[Case]:
    """All cases, the same every time."""
    groups = [(REAL, listed_pairs(REAL)), (HARD, listed_pairs(HARD))]
    found = [_read(folder, listed) for folder, listed in groups]
    for (_, listed), scans in zip(groups, found, strict=True):
        yield from _overlapping(listed, scans)
    scans = [scan for group in found for scan in group.values()]
    yield from _strangers(scans)
    yield from _ends(scans)
    yield from _made()
    yield from _rooms()
    yield from _simulated()


class Scan(NamedTuple):
    """One thinned scan."""

    name: str
    scene: str
    voxel: float
    cloud: tr.Clouds


SAME_PLACE = {"3dmatch_demo": "redkitchen"}
"""Scenes that are parts of another one, as far as is known: they are no strangers to each other."""


def _scene(pair: dict) -> str:
    """The place that a pair shows: of a thinned pair that of its target."""
    scene = pair["target"].split("/")[-2] if pair["scene"] == "mixed_density" else pair["scene"]
    return SAME_PLACE.get(scene, scene)


def _read(folder: Path, listed: list[dict]) -> dict[str, Scan]:
    """The scans of some pairs by file. Their zero is the scanner, but for objects in a published frame."""
    scans = {}
    for pair in listed:
        for side in ("source", "target"):
            place = None if pair["scene"] in NO_SCANNER else "origin"
            file, voxel = pair[side], pair["voxel_m"]
            if file not in scans or scans[file].voxel > voxel:
                cloud = tr.voxel_downsample(tr.read_cloud(folder / file, viewpoint=place), voxel)
                scans[file] = Scan(file, _scene(pair), voxel, cloud)
    return scans


def _overlapping(listed: list[dict], scans: dict[str, Scan]) -> Iterator[Case]:
    g = torch.Generator().manual_seed(1)
    for number, pair in enumerate(listed):
        source, target = scans[pair["source"]].cloud, scans[pair["target"]].cloud
        truth = torch.tensor(pair["T"], dtype=torch.float64)
        height = _heights(source, torch.randn(3, generator=g))
        cut = _part(source, height > height.quantile(0.4))
        common = {"scenes": (_scene(pair),), "voxel": pair["voxel_m"], "truth": truth}
        yield Case(name=pair["name"], kind="pairs", source=source, target=target, **common)
        if number % 2 == 1:
            yield Case(name=pair["name"], kind="cut", source=cut, target=target, **common)
        if number % 2 == 0 and source.colors is not None and target.colors is not None:
            yield Case(name=pair["name"], kind="gray", source=_gray(source), target=_gray(target), **common)
        assumed = [replace(cloud, viewpoint_assumed=torch.ones(1, dtype=torch.bool)) for cloud in (source, target)]
        yield Case(name=pair["name"], kind="assumed", source=assumed[0], target=assumed[1], **common)


def _strangers(scans: list[Scan]) -> Iterator[Case]:
    by_scene: dict[str, list[Scan]] = {}
    for scan in scans:
        by_scene.setdefault(scan.scene, []).append(scan)
    draw, number = random.Random(0), 0
    for first, second in combinations(sorted(by_scene), 2):
        for _ in range(PER_SCENES):
            one, other = draw.choice(by_scene[first]), draw.choice(by_scene[second])
            source, target = one.cloud, _scaled(other.cloud, one.voxel / other.voxel)
            number += 1
            if number % 4 == 0 or (source.colors is None) != (target.colors is None):
                source, target = _gray(source), _gray(target)
            yield Case(f"{one.name} {other.name}", "strangers", (first, second), source, target, one.voxel, None)


def _ends(scans: list[Scan]) -> Iterator[Case]:
    g = torch.Generator().manual_seed(2)
    for scan in scans[::2]:
        cloud = scan.cloud
        centered = cloud.points - cloud.points.mean(dim=0)
        longest = torch.linalg.eigh(centered.t() @ centered).eigenvectors[:, 2]
        height = _heights(cloud, longest)
        source, target = _part(cloud, height < height.quantile(0.4)), _part(cloud, height > height.quantile(0.6))
        turn = torch.linalg.qr(torch.randn(3, 3, generator=g, dtype=torch.float64)).Q
        turn = turn * torch.det(turn)
        moved = tr.transform(source, rigid(turn, torch.zeros(3, dtype=torch.float64)))
        yield Case(scan.name, "two ends", (scan.scene,), moved, target, scan.voxel, None)


def _made() -> Iterator[Case]:
    """Pairs that invite a wrong answer, made from numbers alone, by seeds of their own."""
    module = made_pairs()
    for kind in module.KINDS:
        for seed in range(FIRST_SEED, FIRST_SEED + PER_KIND):
            source, target, truth = module.make(kind, seed)
            T = None if truth is None else torch.from_numpy(truth)
            yield Case(f"{kind} {seed}", "made", (kind,), _made_cloud(source), _made_cloud(target), None, T)


def made_pairs() -> ModuleType:
    """The module that makes them."""
    specification = spec_from_file_location("made_pairs", MADE)
    if specification is None or specification.loader is None:
        raise SystemExit(f"not there: {MADE}")
    module = module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def _made_cloud(made: dict) -> tr.Clouds:
    def tensor(name: str) -> Tensor | None:
        return None if made[name] is None else torch.from_numpy(made[name]).float()

    viewpoint = tensor("viewpoint")
    return tr.Clouds(
        points=tensor("points"), colors=tensor("colors"), viewpoint=None if viewpoint is None else viewpoint[None]
    )


def _rooms() -> Iterator[Case]:
    """Furnished rooms from known stations: one from two stations, and two of the same size that are furnished apart."""
    module = made_pairs()
    for seed in range(FIRST_SEED, FIRST_SEED + ROOMS):
        rng = np.random.default_rng(seed)
        size = (rng.uniform(5, 9), rng.uniform(4, 7), rng.uniform(2.5, 3.2))
        one, other = (module.room(rng, 12000, 6, size)[0] for _ in range(2))
        eyes = [np.array([size[0] * share, size[1] / 2, 1.5]) for share in (0.3, 0.7)]
        T = module.pose(rng)
        moved = [module.visible(module.noise(rng, one), eyes[0]), eyes[0][None]]
        points, eye = (module.moved(T, part) for part in moved)
        source = _made_cloud({"points": points, "colors": None, "viewpoint": eye[0]})
        for name, room, truth in (("same", one, torch.from_numpy(T).inverse()), ("other", other, None)):
            seen = module.visible(module.noise(rng, room), eyes[1])
            target = _made_cloud({"points": seen, "colors": None, "viewpoint": eyes[1]})
            yield Case(f"{name} room {seed}", "rooms", ("rooms",), source, target, None, truth)


def _simulated() -> Iterator[Case]:
    """Halls and roads: two scans of each, and scans of two different ones."""
    for name, make in (("mall", tr.datasets.mall), ("road", tr.datasets.road)):
        pairs = [make(seed=seed, baseline=4.0 + 2.0 * (seed % 3)) for seed in range(FIRST_SEED, FIRST_SEED + SIMULATED)]
        for pair, other in zip(pairs, [*pairs[1:], pairs[0]], strict=True):
            yield Case(pair.name, "simulated", (name,), pair.source, pair.target, None, pair.T_target_source)
            yield Case(f"{pair.name} {other.name}", "simulated", (name,), pair.source, other.target, None, None)


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
