"""The study of methods on the pairs of a list."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from torchreg.benchmark.core.real_pairs import LIST, RealPair, read_real_pairs
from torchreg.benchmark.core.study import Study
from torchreg.benchmark.field.document import CAPTION, csv_text, tables
from torchreg.benchmark.field.summary import MATCH_VOXELS
from torchreg.benchmark.peers.comparison import TruePair, chosen_scenes, comparison_study
from torchreg.io import read_cloud


def field_study(
    data: Path,
    *,
    methods: Sequence[str] | None = None,
    scenes: Sequence[str] | None = None,
    quick: bool = False,
    device: str = "cpu",
    seed: int = 0,
) -> Study:
    """The study of methods on real pairs of known truth.

    Args:
        data: the list of pairs, or the folder that holds it.
        methods: their names; ``None`` takes all.
        scenes: whose pairs are taken; ``None`` takes all.
        quick: of every scene only the pair that overlaps most; slow methods only where they are named.
        device: where torchreg computes.
        seed: of every random draw and of the intervals.

    Raises:
        CloudFileError: the list cannot be read.
        ValueError: an unknown scene or method.
    """
    pairs = chosen_pairs(data, scenes, quick=quick)
    return comparison_study(
        "field",
        [_true_pair(pair) for pair in pairs],
        methods,
        {"pairs": hashlib.sha256((data / LIST if data.is_dir() else data).read_bytes()).hexdigest()[:16]},
        title="The field on real pairs",
        caption=lambda _: CAPTION,
        tables=tables,
        csv=csv_text,
        shown=2,
        seed=seed,
        device=device,
        quick=quick,
    )


def chosen_pairs(data: Path, scenes: Sequence[str] | None = None, *, quick: bool = False) -> list[RealPair]:
    """The pairs of some scenes, or with ``quick`` the one of each that overlaps most."""
    listed = read_real_pairs(data)
    wanted = chosen_scenes(scenes, [pair.scene for pair in listed])
    pairs = [pair for pair in listed if pair.scene in wanted]
    if not quick:
        return pairs
    by_scene: dict[str, list[RealPair]] = {}
    for pair in pairs:
        by_scene.setdefault(pair.scene, []).append(pair)
    return [max(of_scene, key=lambda pair: pair.overlap) for of_scene in by_scene.values()]


def _true_pair(pair: RealPair) -> TruePair:
    return TruePair(
        name=pair.name,
        facts={"scene": pair.scene, "overlap": pair.overlap},
        read=lambda: (read_cloud(pair.source), read_cloud(pair.target)),
        voxel=pair.voxel,
        near=MATCH_VOXELS * pair.voxel,
        T_true=pair.T_target_source,
    )
