"""The study of methods on the pairs of a list."""

from __future__ import annotations

import hashlib
from pathlib import Path

from torchreg.benchmark.core.real_pairs import LIST, RealPair, read_real_pairs
from torchreg.benchmark.core.study import Study
from torchreg.benchmark.field.document import CAPTION, csv_text, tables
from torchreg.benchmark.field.summary import MATCH_VOXELS
from torchreg.benchmark.peers.comparison import EVERYTHING, ComparisonOptions, TruePair, comparison_study
from torchreg.io import read_cloud


def field_study(data: Path, options: ComparisonOptions = EVERYTHING) -> Study:
    """The study of methods on real pairs of known truth; a quick run takes one pair of two scenes.

    Args:
        data: the list of pairs, or the folder that holds it.
        options: what is compared.

    Raises:
        CloudFileError: the list cannot be read.
        ValueError: an unknown scene or method.
    """
    return comparison_study(
        "field",
        [true_pair(pair) for pair in read_real_pairs(data)],
        options,
        {"pairs": list_digest(data)},
        title="The field on real pairs",
        caption=lambda _: CAPTION,
        tables=tables,
        csv=csv_text,
        shown=2,
        rank=lambda pair: pair.facts["overlap"],
    )


def list_digest(data: Path) -> str:
    """Digits that name the content of a list of pairs: rows of another list are not taken for these."""
    return hashlib.sha256((data / LIST if data.is_dir() else data).read_bytes()).hexdigest()[:16]


def true_pair(pair: RealPair) -> TruePair:
    """A pair of a list, to be measured by bounds that follow its voxels."""
    return TruePair(
        name=pair.name,
        facts={"scene": pair.scene, "overlap": pair.overlap},
        read=lambda: (read_cloud(pair.source), read_cloud(pair.target)),
        voxel=pair.voxel,
        near=MATCH_VOXELS * pair.voxel,
        T_true=pair.T_target_source,
    )
