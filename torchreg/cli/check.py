"""``torchreg check``: torchreg and Open3D side by side on one pair."""

from __future__ import annotations

from enum import Enum
from typing import Annotated

import typer
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from torchreg.cli import options as opt
from torchreg.cli.expand import expanded
from torchreg.cli.guard import NOT_REGISTERED, complain
from torchreg.cli.output import STANDARD_OUTPUT, Output, check_outputs, standard_output, write_json
from torchreg.cli.pair import PairArguments, options_of_pair, read_pair
from torchreg.cli.progress import step
from torchreg.metrics import rre
from torchreg.reference.comparison import Comparison
from torchreg.reference.descriptors import DescriptorDifference
from torchreg.settings import StageSettings

_LISTED_TIES = 3


class ComparedFeatures(str, Enum):
    """What both sides match."""

    fused = "fused"
    fpfh = "fpfh"


@expanded
def check(
    files: PairArguments,
    settings: StageSettings,
    features: Annotated[
        ComparedFeatures,
        typer.Option(
            "--features",
            help="Features that both sides match. fused: torchreg's, color included. fpfh: each its own FPFH.",
            rich_help_panel="Search",
        ),
    ] = ComparedFeatures.fused,
    threads: opt.Threads = None,
    json: opt.JsonFile = None,
) -> None:
    """Register SOURCE to TARGET with torchreg and with Open3D, and compare their stages, lengths in meters.

    Both run the same plain procedure, RANSAC on mutual matches; torchreg register does more by default.
    FPFH are compared row by row with the same normals and neighborhoods; a row is tied where rounding decides a
    vote in it. Exit code 0: all rows that are not tied agree, and torchreg registered the pair. 2: bad usage or an
    unreadable file. 3: rows differ, or the registration failed.
    """
    from torchreg.io.result_json import versions
    from torchreg.reference import compare

    check_outputs([Output("--json", json)], files.paths)
    opt.use(opt.Device.cpu, threads)
    T_true = files.transform()
    pair = read_pair(files, settings)
    with step(f"registering {pair.words[0]} to {pair.words[1]} with torchreg and with Open3D"):
        options = options_of_pair(*pair.used, settings)
        comparison = compare(*pair.used, options, truth=T_true, seed=settings.seed, features=features.value)

    good = comparison.descriptors_agree and comparison.torchreg.success
    if json is not None:
        run = {name: getattr(settings, name) for name in ("preset", "points", "viewpoint", "seed")}
        names = {"source": str(files.source), "target": str(files.target)}
        write_json(json, {**names, "agree": good, **comparison.to_dict(), "run": run, "versions": versions()})
    if json == STANDARD_OUTPUT:
        complain(_verdict(comparison))
    else:
        standard_output().print(_report(comparison, pair.words))
    if not good:
        raise typer.Exit(NOT_REGISTERED)


def _report(comparison: Comparison, words: tuple[str, str]) -> Group:
    from torchreg.report import matrix_text
    from torchreg.report.text import plain

    parts: list[RenderableType] = [plain(f"source  {words[0]}"), plain(f"target  {words[1]}"), ""]
    parts += [_side_by_side(comparison), ""]
    sides = (("torchreg", comparison.torchreg), ("Open3D", comparison.open3d))
    for name, side in sides:
        if side.success:
            parts += [f"T_target_source by {name}", Text(matrix_text(side.T_target_source), no_wrap=True), ""]
    if comparison.descriptors:
        parts += [_descriptors(comparison.descriptors), *_ties(comparison.descriptors), ""]
    for name, side in sides:
        parts += [plain(f"note on {name}: {note}") for note in side.notes]
    good = comparison.descriptors_agree and comparison.torchreg.success
    return Group(*parts, Text(_verdict(comparison), style="bold green" if good else "bold red"))


def _side_by_side(comparison: Comparison) -> Table:
    table = Table("", "torchreg, plain RANSAC", "Open3D", box=None, header_style="bold", pad_edge=False)
    sides = (comparison.torchreg, comparison.open3d)
    table.add_row("registered", *(Text("yes" if side.success else f"no: {side.reason}") for side in sides))
    table.add_row("matches", *(f"{side.matches:,} ({comparison.shared_matches:,} shared)" for side in sides))
    table.add_row("inliers", *(f"{side.inliers:,}" for side in sides))
    table.add_row("fitness", *(_number(side.fitness) for side in sides))
    table.add_row("inlier_rmse (m)", *(_number(side.inlier_rmse) for side in sides))
    if any(side.truth is not None for side in sides):
        for place, name in enumerate(("RRE (degrees)", "RTE (m)", "RMSE (m)")):
            table.add_row(name, *(_number(None if side.truth is None else side.truth[place]) for side in sides))
    for stage in dict.fromkeys(name for side in sides for name in side.seconds):
        table.add_row(f"{stage} (s)", *(_number(side.seconds.get(stage)) for side in sides))
    table.add_row("these stages (s)", *(_number(side.total_seconds) for side in sides))
    return table


def _descriptors(differences: tuple[DescriptorDifference, ...]) -> Table:
    headers = ("FPFH against Open3D", "rows", "largest difference", "rows off", "of these tied", "tied rows")
    table = Table(*headers, box=None, header_style="bold", pad_edge=False)
    for one in differences:
        name = f"{one.cloud}, {one.dtype}, within {one.tolerance:g}"
        off, tied = f"{one.off:,} ({100 * one.share_off:.3g} %)", f"{one.off - one.off_without_tie:,}"
        table.add_row(name, f"{one.rows:,}", f"{one.largest:.2g} of 600", off, tied, f"{one.tied:,}")
    return table


def _ties(differences: tuple[DescriptorDifference, ...]) -> list[str]:
    """A line per cloud with ties: its first pairs whose vote rounding decides."""
    lines = []
    for one in differences:
        if one.dtype == "float64" and one.tie_count > 0:
            pairs = "; ".join(f"rows {tie.row} and {tie.neighbor}, {tie.kind}" for tie in one.ties[:_LISTED_TIES])
            more = ", ..." if one.tie_count > _LISTED_TIES else ""
            lines.append(f"{one.tie_count:,} tied pairs in the {one.cloud}: {pairs}{more}")
    return lines


def _verdict(comparison: Comparison) -> str:
    if not comparison.descriptors:
        verdict = "FPFH not compared"
    elif comparison.descriptors_agree:
        verdict = "FPFH agree"
    else:
        rows = sum(one.off_without_tie for one in comparison.descriptors)
        verdict = f"FPFH differ in {rows:,} rows without a tie"
    registered = "registered" if comparison.torchreg.success else f"not registered: {comparison.torchreg.reason}"
    sides = (comparison.torchreg, comparison.open3d)
    if not all(side.success for side in sides):
        return f"{verdict}; torchreg {registered}"
    apart = float(rre(*(side.T_target_source[None] for side in sides)))
    return f"{verdict}; torchreg {registered}, its pose turned by {apart:.3g} degrees against Open3D's"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
