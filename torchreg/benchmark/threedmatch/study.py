"""The study of methods on the fragments of a folder."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from torchreg.benchmark.core.study import Study
from torchreg.benchmark.peers.comparison import TruePair, chosen_scenes, comparison_study
from torchreg.benchmark.threedmatch.document import caption, csv_text, tables
from torchreg.benchmark.threedmatch.protocol import NEAR
from torchreg.datasets import Fragments
from torchreg.types import Clouds


def fragments_study(
    folder: Path,
    *,
    log: Path | None = None,
    methods: Sequence[str] | None = None,
    scenes: Sequence[str] | None = None,
    voxel: float = 0.05,
    quick: bool = False,
    device: str = "cpu",
    seed: int = 0,
) -> Study:
    """The study of methods on scenes of fragments.

    Args:
        folder: a scene, or a folder of scenes, as ``Fragments`` takes it.
        log: which log, as ``Fragments`` takes it.
        methods: their names; ``None`` takes all.
        scenes: folders whose pairs are taken; ``None`` takes all.
        voxel: meters, what all clouds are averaged over.
        quick: of every scene only the first pair whose fragments do not follow one another; slow methods only where
            they are named.
        device: where torchreg computes.
        seed: of every random draw and of the intervals.

    Raises:
        CloudFileError: what ``Fragments`` refuses.
        ValueError: an unknown scene or method.
    """
    dataset = Fragments(folder, log=log)
    return comparison_study(
        "3dmatch",
        chosen_pairs(dataset, scenes, voxel, quick=quick),
        methods,
        {
            "folder": os.path.abspath(folder),
            "log": None if log is None else str(log),
            "truth": _truth(dataset),
            "voxel": voxel,
        },
        title="Registration of fragments by the protocol of 3DMatch",
        caption=partial(caption, voxel=voxel),
        tables=tables,
        csv=csv_text,
        shown=3,
        seed=seed,
        device=device,
        quick=quick,
    )


def chosen_pairs(
    dataset: Fragments, scenes: Sequence[str] | None, voxel: float, *, quick: bool = False
) -> list[TruePair]:
    """The pairs of some scenes, or with ``quick`` the first of each that registration recall counts."""
    wanted = chosen_scenes(scenes, dataset.scenes)
    pairs = [_true_pair(dataset, k, voxel) for k, scene in enumerate(dataset.scenes) if scene in wanted]
    if not quick:
        return pairs
    first: dict[str, TruePair] = {}
    for pair in pairs:
        if pair.facts["j"] - pair.facts["i"] > 1:
            first.setdefault(pair.facts["scene"], pair)
    return list(first.values())


def _truth(dataset: Fragments) -> str:
    """A digest of all poses and information matrices: rows measured against others are not taken for these."""
    digest = hashlib.sha256()
    for k, name in enumerate(dataset.names):
        digest.update(name.encode())
        digest.update(dataset.T_target_source[k].numpy().tobytes())
        if dataset.information is not None:
            digest.update(dataset.information[k].numpy().tobytes())
    return digest.hexdigest()[:16]


def _true_pair(dataset: Fragments, k: int, voxel: float) -> TruePair:
    i, j = dataset.numbers[k]

    def read() -> tuple[Clouds, Clouds]:
        return dataset.reader.read(dataset.sources[k]), dataset.reader.read(dataset.targets[k])

    information = None if dataset.information is None else dataset.information[k]
    if information is not None and bool(information.isnan().all()):
        information = None
    return TruePair(
        name=dataset.names[k],
        facts={"scene": dataset.scenes[k], "i": i, "j": j},
        read=read,
        voxel=voxel,
        near=NEAR,
        T_true=dataset.T_target_source[k],
        information=information,
    )
