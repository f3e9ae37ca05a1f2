"""The study of methods on the fragments of a folder."""

from __future__ import annotations

import hashlib
import os
from functools import partial
from pathlib import Path

from torchreg.benchmark.core.study import Study
from torchreg.benchmark.peers.comparison import EVERYTHING, ComparisonOptions, TruePair, comparison_study
from torchreg.benchmark.threedmatch.document import caption, csv_text, tables
from torchreg.benchmark.threedmatch.protocol import NEAR, counts
from torchreg.datasets import Fragments
from torchreg.types import Clouds


def fragments_study(
    folder: Path,
    options: ComparisonOptions = EVERYTHING,
    *,
    log: Path | None = None,
    voxel: float = 0.05,
    name: str = "3dmatch",
) -> Study:
    """The study of methods on scenes of fragments; a quick run takes the first pair that registration recall counts.

    Args:
        folder: a scene, or a folder of scenes, as ``Fragments`` takes it.
        options: what is compared.
        log: which log, as ``Fragments`` takes it.
        voxel: meters, what all clouds are averaged over.
        name: of the files.

    Raises:
        CloudFileError: what ``Fragments`` refuses.
        ValueError: an unknown scene or method.
    """
    dataset = Fragments(folder, log=log)
    return comparison_study(
        name,
        [_true_pair(dataset, k, voxel) for k in range(len(dataset.names))],
        options,
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
        rank=lambda pair: counts(pair.facts),
    )


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
