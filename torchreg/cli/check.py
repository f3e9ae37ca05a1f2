"""``torchreg check``: torchreg and Open3D side by side on one pair."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from torchreg.cli import options as opt
from torchreg.cli.expand import expanded
from torchreg.cli.guard import NOT_REGISTERED, complain
from torchreg.cli.output import STANDARD_OUTPUT, Output, check_outputs, standard_output, write_json
from torchreg.cli.overrides import Overrides, options_for
from torchreg.cli.pair import PairInput, read_pair
from torchreg.cli.progress import step

if TYPE_CHECKING:
    from torchreg.reference.comparison import Comparison
    from torchreg.reference.descriptors import DescriptorDifference

_NAMED = 3


class Matched(str, Enum):
    """What both sides match."""

    fused = "fused"
    fpfh = "fpfh"


MatchedFeatures = Annotated[
    Matched,
    typer.Option(
        "--features",
        help="What both sides match (a name). fused: torchreg's features, color included. fpfh: each its own FPFH.",
        rich_help_panel="Search",
    ),
]


@expanded
def check(
    pair_input: PairInput,
    overrides: Overrides,
    features: MatchedFeatures = Matched.fused,
    threads: opt.Threads = None,
    json: opt.JsonFile = None,
) -> None:
    """Register SOURCE to TARGET with torchreg and with Open3D, and compare what every stage gave, in meters.

    FPFH are compared row by row with the same normals and neighborhoods; a row is tied where rounding decides a
    vote in it. Exit code 0: all rows that are not tied agree, and torchreg registered the pair. 2: bad usage or an
    unreadable file. 3: rows differ, or the registration failed.
    """
    from torchreg.cli.device import use
    from torchreg.io.result_json import versions
    from torchreg.reference import compare

    check_outputs([Output("--json", json)], pair_input.paths)
    use(opt.Device.cpu, threads)
    T_true = pair_input.transform()
    pair = read_pair(pair_input)
    with step(f"registering {pair.words[0]} to {pair.words[1]} with torchreg and with Open3D"):
        options = options_for(*pair.used, overrides)
        found = compare(*pair.used, options, truth=T_true, seed=pair_input.seed, features=features.value)

    good = found.descriptors_agree and found.torchreg.success
    if json is not None:
        run = {"preset": overrides.preset.value, **pair_input.run(), "seed": pair_input.seed}
        names = {"source": str(pair_input.source), "target": str(pair_input.target)}
        write_json(json, {**names, "agree": good, **found.to_dict(), "run": run, "versions": versions()})
    if json == STANDARD_OUTPUT:
        complain(_verdict(found))
    else:
        standard_output().print(_report(found, pair.words))
    if not good:
        raise typer.Exit(NOT_REGISTERED)


def _report(found: Comparison, words: tuple[str, str]) -> Group:
    from torchreg.report import matrix_text
    from torchreg.report.text import plain

    parts: list[RenderableType] = [plain(f"source  {words[0]}"), plain(f"target  {words[1]}"), ""]
    parts += [_side_by_side(found), ""]
    sides = (("torchreg", found.torchreg), ("Open3D", found.open3d))
    for name, side in sides:
        if side.success:
            parts += [f"T_target_source by {name}", Text(matrix_text(side.T_target_source), no_wrap=True), ""]
    if found.descriptors:
        parts += [_descriptors(found.descriptors), *_ties(found.descriptors), ""]
    for name, side in sides:
        parts += [plain(f"note on {name}: {note}") for note in side.notes]
    good = found.descriptors_agree and found.torchreg.success
    return Group(*parts, Text(_verdict(found), style="bold green" if good else "bold red"))


def _side_by_side(found: Comparison) -> Table:
    table = Table("", "torchreg", "Open3D", box=None, header_style="bold", pad_edge=False)
    sides = (found.torchreg, found.open3d)
    table.add_row("registered", *(Text("yes" if side.success else f"no: {side.reason}") for side in sides))
    table.add_row("matches", *(f"{side.matches:,} ({found.shared_matches:,} shared)" for side in sides))
    table.add_row("inliers", *(f"{side.inliers:,}" for side in sides))
    table.add_row("fitness", *(_number(side.fitness) for side in sides))
    table.add_row("inlier_rmse (m)", *(_number(side.inlier_rmse) for side in sides))
    if any(side.truth is not None for side in sides):
        for place, name in enumerate(("RRE (degrees)", "RTE (m)", "RMSE (m)")):
            table.add_row(name, *(_number(None if side.truth is None else side.truth[place]) for side in sides))
    for stage in dict.fromkeys(name for side in sides for name, _ in side.seconds):
        table.add_row(f"{stage} (s)", *(_number(dict(side.seconds).get(stage)) for side in sides))
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
            pairs = "; ".join(f"rows {tie.row} and {tie.neighbor}, {tie.kind}" for tie in one.ties[:_NAMED])
            more = ", ..." if one.tie_count > _NAMED else ""
            lines.append(f"{one.tie_count:,} tied pairs in the {one.cloud}: {pairs}{more}")
    return lines


def _verdict(found: Comparison) -> str:
    if not found.descriptors:
        said = "FPFH not compared"
    elif found.descriptors_agree:
        said = "FPFH agree"
    else:
        rows = sum(one.off_without_tie for one in found.descriptors)
        said = f"FPFH differ in {rows:,} rows without a tie"
    registered = "registered" if found.torchreg.success else f"not registered: {found.torchreg.reason}"
    return f"{said}; torchreg {registered}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
