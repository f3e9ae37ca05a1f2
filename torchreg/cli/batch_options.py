"""What ``torchreg batch`` takes beside what other commands take too."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

_INPUT, _RUN, _OUTPUT = "Input", "Run", "Output"


class EngineKind(str, Enum):
    """What runs the work."""

    local = "local"
    ray = "ray"


class ScaleKind(str, Enum):
    """What the default lengths follow."""

    shared = "shared"
    pair = "pair"


ScaleName = Annotated[
    ScaleKind,
    typer.Option(
        "--scale",
        help="What the default lengths follow (a name). shared: one spacing for clouds that pairs link and that are "
        "about equally dense, so that each is described once. pair: the two clouds alone, as torchreg register.",
        rich_help_panel="Lengths",
    ),
]
PairsFile = Annotated[
    Path | None,
    typer.Argument(
        metavar="[PAIRS]",
        show_default=False,
        help="A table of pairs (.csv, columns source and target; file names relative to its folder).",
    ),
]
AllPairs = Annotated[
    str | None,
    typer.Option(
        "--all-pairs",
        metavar="PATTERN",
        help="Instead of a table: every two of the files that this pattern names, such as 'scans/*.ply' (a text).",
        rich_help_panel=_INPUT,
    ),
]
RecallDegrees = Annotated[
    float,
    typer.Option(
        "--recall-degrees",
        metavar="DEGREES",
        min=0,
        help="A pair with a truth counts as found below this rotation error, in degrees.",
        rich_help_panel=_INPUT,
    ),
]
RecallMeters = Annotated[
    float | None,
    typer.Option(
        "--recall-meters",
        metavar="METERS",
        min=0,
        help="And below this translation error, in meters; four inlier thresholds of the pair unless told.",
        rich_help_panel=_INPUT,
    ),
]
Out = Annotated[
    Path,
    typer.Option(
        "--out",
        metavar="DIR",
        help="The folder of the results, made if need be (a path); one that was begun is gone on with.",
        rich_help_panel=_OUTPUT,
    ),
]
EngineName = Annotated[
    EngineKind,
    typer.Option(
        "--engine",
        help="What runs the work (a name): processes of this machine (local), or Ray's workers, here or on a cluster "
        "(ray). The results are the same.",
        rich_help_panel=_RUN,
    ),
]
RayAddress = Annotated[
    str | None,
    typer.Option(
        "--ray-address",
        metavar="ADDRESS",
        help="A Ray cluster to join (a text such as HOST:PORT, ray://HOST:PORT, or auto); one is started here unless "
        "told.",
        rich_help_panel=_RUN,
    ),
]
Workers = Annotated[
    int | None,
    typer.Option(
        "--workers",
        metavar="COUNT",
        min=0,
        help="Processes that work at once (a count; as many as there are cores unless told; 0 works in this one).",
        rich_help_panel=_RUN,
    ),
]
Cache = Annotated[
    Path | None,
    typer.Option(
        "--cache",
        metavar="DIR",
        help="Where described clouds are kept, to be shared by several batches (a path; DIR/described unless told).",
        rich_help_panel=_RUN,
    ),
]
MaxBytes = Annotated[
    int | None,
    typer.Option(
        "--max-bytes",
        metavar="BYTES",
        min=1,
        help="About what pairs that are registered together may hold, over all workers (bytes; a quarter of what is "
        "free unless told).",
        rich_help_panel=_RUN,
    ),
]
