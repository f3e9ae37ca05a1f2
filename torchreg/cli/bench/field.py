"""``torchreg bench field``: methods of the field on real pairs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchreg.cli.bench.shared import ComparisonRun, Out, expect_folder, run_and_show
from torchreg.cli.expand import expanded

Data = Annotated[
    Path, typer.Option("--data", metavar="PATH", help="List of pairs (JSON), or the folder with its pairs.json.")
]


@expanded
def field(data: Data, run: ComparisonRun, out: Out = Path("torchreg_field")) -> None:
    """Compare torchreg with Open3D, KISS-Matcher and others on real pairs of known truth.

    Registration recall by errors and by RMSE, feature-match recall, inlier ratio, RRE in degrees, RTE in meters and
    seconds, by scene and by overlap, with 95 % intervals over the pairs. All methods get the same clouds and lengths.
    A method whose package is not installed is listed as such. --quick takes one pair of each of two scenes, those that
    overlap most.

    Exit code 0: all methods that are installed were measured. 2: bad usage, or a file that cannot be read.
    """
    from torchreg.benchmark.field.study import field_study

    expect_folder(out)
    run_and_show(field_study(data, run.options()), out)
