"""What several commands take, as types: ``seed: Seed = 0`` in a command's parameters is the option ``--seed``."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer


class Preset(str, Enum):
    """Registration options by name."""

    default = "default"
    paper = "paper"


class Effort(str, Enum):
    """How much a registration tries, as ``register`` names it."""

    plain = "plain"
    fast = "fast"
    balanced = "balanced"
    thorough = "thorough"


class Solver(str, Enum):
    """What turns matches into poses."""

    ransac = "ransac"
    compatibility = "compatibility"


class Device(str, Enum):
    """Where tensors are computed."""

    cpu = "cpu"
    cuda = "cuda"


_INPUT, _SCALE, _SEARCH, _RUN, _OUTPUT = "Input", "Lengths", "Search", "Run", "Output"

Source = Annotated[
    Path,
    typer.Argument(metavar="SOURCE", help="The cloud that is moved: a .ply, .pcd or .npz file, coordinates in meters."),
]
Target = Annotated[
    Path,
    typer.Argument(metavar="TARGET", help="The cloud that stays: a .ply, .pcd or .npz file, coordinates in meters."),
]

Points = Annotated[
    int | None,
    typer.Option(
        "--points",
        metavar="COUNT",
        min=1,
        help="Keep this many points of each cloud first, chosen at random (a count; the paper: 10000).",
        rich_help_panel=_INPUT,
    ),
]
ViewpointText = Annotated[
    str,
    typer.Option(
        "--viewpoint",
        metavar="auto|origin|none|X,Y,Z",
        help="Where the scanner stood, towards which normals are turned: as the file says or else at its zero (auto), "
        "at its zero (origin), not known (none), or a position in meters in the frame of both files.",
        rich_help_panel=_INPUT,
    ),
]
TruthFile = Annotated[
    Path | None,
    typer.Option(
        "--truth",
        metavar="FILE",
        help="The true transform, 4x4 text or JSON, in meters: adds the errors RRE (degrees), RTE and RMSE (meters).",
        rich_help_panel=_INPUT,
    ),
]

PresetName = Annotated[
    Preset,
    typer.Option(
        "--preset",
        help="default: every length from the spacing of the points. paper: the paper's lengths in meters, for scans "
        "of buildings, with FPFH and PCFH of equalized hue.",
        rich_help_panel=_SCALE,
    ),
]
Voxel = Annotated[
    float | None,
    typer.Option(
        "--voxel",
        metavar="METERS",
        help="Average the points over cubes of this edge first, in meters.",
        rich_help_panel=_SCALE,
    ),
]
NormalRadius = Annotated[
    float | None,
    typer.Option(
        "--normal-radius", metavar="METERS", help="Support radius of a normal, in meters.", rich_help_panel=_SCALE
    ),
]
FeatureRadius = Annotated[
    float | None,
    typer.Option(
        "--feature-radius", metavar="METERS", help="Support radius of FPFH, in meters.", rich_help_panel=_SCALE
    ),
]
ColorRadius = Annotated[
    float | None,
    typer.Option(
        "--color-radius",
        metavar="METERS",
        help="Support radius of the color features, in meters.",
        rich_help_panel=_SCALE,
    ),
]
InlierThreshold = Annotated[
    float | None,
    typer.Option(
        "--inlier-threshold",
        metavar="METERS",
        help="A match farther apart than this after the transform is an outlier, in meters.",
        rich_help_panel=_SCALE,
    ),
]

EffortName = Annotated[
    Effort | None,
    typer.Option(
        "--effort",
        help="How much is tried (a name; balanced unless told, plain with the paper's preset). plain: one set of "
        "features and one solver, as in the paper. The others let candidate poses compete on the clouds themselves, "
        "from one set of features (fast), two (balanced), or all sets and both solvers (thorough).",
        rich_help_panel=_SEARCH,
    ),
]
SolverName = Annotated[
    Solver | None,
    typer.Option(
        "--solver",
        help="What turns matches into poses (a name; compatibility unless told, ransac with the paper's preset).",
        rich_help_panel=_SEARCH,
    ),
]
Hypotheses = Annotated[
    int | None,
    typer.Option(
        "--hypotheses",
        metavar="COUNT",
        help="How many minimal samples RANSAC draws at most, where it is the solver (a count; 600000 unless told).",
        rich_help_panel=_SEARCH,
    ),
]
Confidence = Annotated[
    float | None,
    typer.Option(
        "--confidence",
        metavar="PROBABILITY",
        help="Drawing stops once a better sample would have been drawn with this probability (no unit, above 0 up "
        "to 1; 1 draws all; 0.999 unless told).",
        rich_help_panel=_SEARCH,
    ),
]
NoColor = Annotated[
    bool,
    typer.Option(
        "--no-color", help="Leave color out of the features: geometry alone (a switch).", rich_help_panel=_SEARCH
    ),
]

Seed = Annotated[
    int,
    typer.Option(
        "--seed",
        metavar="NUMBER",
        min=0,
        help="Of every random draw (a whole number, no unit): the same seed gives the same result.",
        rich_help_panel=_RUN,
    ),
]
DeviceName = Annotated[
    Device,
    typer.Option("--device", help="Where to compute (a name): on the processor or on a GPU.", rich_help_panel=_RUN),
]
Threads = Annotated[
    int | None,
    typer.Option(
        "--threads",
        metavar="COUNT",
        min=1,
        help="Processor threads to use (a count; as many as PyTorch chooses unless told).",
        rich_help_panel=_RUN,
    ),
]

JsonFile = Annotated[
    Path | None,
    typer.Option(
        "--json",
        metavar="FILE",
        help="Write the result as JSON (lengths in meters, times in seconds); - is standard output, with nothing "
        "else on it.",
        rich_help_panel=_OUTPUT,
    ),
]
JsonSwitch = Annotated[
    bool, typer.Option("--json", help="Print JSON instead of a table (lengths in meters).", rich_help_panel=_OUTPUT)
]
FigureFile = Annotated[
    Path | None,
    typer.Option(
        "--figure",
        metavar="FILE.png",
        help="Draw before and after from three sides, axes in meters (.png, .pdf or .svg).",
        rich_help_panel=_OUTPUT,
    ),
]


ExplainSwitch = Annotated[
    bool,
    typer.Option(
        "--explain",
        help="Say after the table what each stage had and lost, which poses were weighed and what may help (a switch).",
        rich_help_panel=_OUTPUT,
    ),
]
MatchesFile = Annotated[
    Path | None,
    typer.Option(
        "--matches",
        metavar="FILE.png",
        help="Draw the matches between both clouds, inliers and outliers told apart, axes in meters (.png, .pdf or "
        ".svg).",
        rich_help_panel=_OUTPUT,
    ),
]
TransformFile = Annotated[
    Path | None,
    typer.Option(
        "--transform",
        metavar="FILE.txt",
        help="Write the transform as four lines of four numbers (translation in meters).",
        rich_help_panel=_OUTPUT,
    ),
]
AlignedFile = Annotated[
    Path | None,
    typer.Option(
        "--aligned",
        metavar="FILE.ply",
        help="Write the whole source in the target's frame, coordinates in meters (.ply or .npz).",
        rich_help_panel=_OUTPUT,
    ),
]
