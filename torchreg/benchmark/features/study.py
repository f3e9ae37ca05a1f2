"""The study of features on pairs: those of a list, or of scenes of fragments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from torchreg.benchmark.core.real_pairs import LIST, read_real_pairs
from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.study import Study
from torchreg.benchmark.features.adapter import FPFH, adapter_methods
from torchreg.benchmark.features.document import caption, csv_text, tables
from torchreg.benchmark.features.protocol import Protocol
from torchreg.benchmark.field.study import list_digest, true_pair
from torchreg.benchmark.peers.comparison import ComparisonOptions, comparison_study
from torchreg.benchmark.threedmatch.study import fragments_study
from torchreg.errors import expect

BESIDE = ("default",)
"""Methods that run beside, where none are named."""

_FRAGMENTS_VOXEL = 0.05


def features_study(
    adapters: Sequence[str],
    data: Path,
    options: ComparisonOptions,
    *,
    in_meters: bool = False,
    log: Path | None = None,
    voxel: float | None = None,
) -> Study:
    """The study of adapters, FPFH and other methods.

    Args:
        adapters: names ``module:callable``.
        data: a list of pairs, or the folder that holds it; or, without a list, scenes of fragments as ``Fragments``
            takes them, which are scored scene by scene as ``fragments_study`` does.
        options: what else is compared.
        in_meters: of a list, bounds of 0.2 m and 0.1 m for every pair, and not by its voxels.
        log: of fragments, which log lists the pairs.
        voxel: meters, what all clouds are averaged over; ``None`` takes the list's, and 0.05 for fragments.

    Raises:
        CloudFileError: the list or the fragments cannot be read.
        ValueError: an unknown scene, method or adapter.
    """
    twice = next((name for name in adapters if adapters.count(name) > 1), None)
    expect(twice is None, "adapter", "each at most once", twice)
    own = [method for name in adapters for method in adapter_methods(name)] + FPFH
    beside = BESIDE if options.methods is None else options.methods
    options = replace(options, methods=beside, more=tuple(own))
    if data.is_dir() and not (data / LIST).exists():
        edge = _FRAGMENTS_VOXEL if voxel is None else voxel
        return _with_errors(fragments_study(data, options, log=log, voxel=edge, name="features"))
    expect(log is None, "--log", "none beside a list of pairs", log)
    protocol = Protocol(in_meters)
    pairs = read_real_pairs(data)
    if voxel is not None:
        pairs = tuple(replace(pair, voxel=voxel) for pair in pairs)
    study = comparison_study(
        "features",
        [replace(true_pair(pair), near=protocol.near(pair.voxel)) for pair in pairs],
        options,
        {"pairs": list_digest(data), "in_meters": in_meters, "voxel": voxel},
        title="Features on pairs of known truth",
        caption=lambda _: caption(protocol),
        tables=partial(tables, protocol=protocol),
        csv=partial(csv_text, protocol=protocol),
        shown=2,
        rank=lambda pair: pair.facts["overlap"],
    )
    return _with_errors(study)


def _with_errors(study: Study) -> Study:
    """The study whose last words are what adapters ended with, which else hides among the numbers."""

    def sentences(rows: Sequence[Row]) -> list[str]:
        ended: dict[str, list[str]] = {}
        for row in rows:
            if row["error"]:
                ended.setdefault(row["method"], []).append(row["error"])
        return [f"{name} ended with an error on {len(of)} pairs, first: {of[0]}" for name, of in ended.items()]

    return replace(study, shown=lambda rows: [*study.shown(rows), *sentences(rows)])
