"""``torchreg bench family``: every descriptor alone and fused, on real pairs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchreg.cli import options as opt
from torchreg.cli.bench.shared import Out, Quick, expect_folder, names_in, run_and_show

RealPairs = Annotated[
    Path | None,
    typer.Option(
        "--real", metavar="PATH", help="List of pairs (JSON), or the folder with its pairs.json: the real pairs."
    ),
]
HardPairs = Annotated[
    Path | None, typer.Option("--hard", metavar="PATH", help="The same of scenes that the library was not made on.")
]
Fusions = Annotated[
    str | None,
    typer.Option(
        "--fusions",
        metavar="NAME,NAME",
        help="Only these, such as pfh,pfh+fpfh+color, and the two that all are set against: fpfh and fpfh+color.",
    ),
]
FamilyScenes = Annotated[
    str | None, typer.Option("--scenes", metavar="NAME,NAME", help="Only the pairs of these scenes.")
]
Every = Annotated[
    int, typer.Option("--every", metavar="COUNT", min=1, help="Of each list every so many-th pair, from the first.")
]
MostPoints = Annotated[
    int | None,
    typer.Option(
        "--points",
        metavar="COUNT",
        min=100,
        help="The most points of a cloud, all by default: larger ones are averaged over wider voxels. Features of a "
        "thousand numbers and more take long to match.",
    ),
]


FamilyEffort = Annotated[
    str,
    typer.Option(
        "--effort",
        metavar="NAME",
        help="Balanced, as register by default; or plain: poses by matches alone, in a fraction of the time.",
    ),
]


def family(
    out: Out = Path("torchreg_family"),
    real: RealPairs = None,
    hard: HardPairs = None,
    fusions: Fusions = None,
    scenes: FamilyScenes = None,
    effort: FamilyEffort = "balanced",
    every: Every = 1,
    points: MostPoints = None,
    quick: Quick = False,
    seed: opt.Seed = 0,
    threads: opt.Threads = None,
) -> None:
    """Measure every descriptor of the library alone, and fused with FPFH and with color, on real pairs.

    Inlier ratio, feature-match recall, registration recall (15 degrees, 6 voxels) by matches alone and by all that
    register does, wrong successes, seconds, numbers of a feature and memory; paired differences from FPFH alone and
    from the default, with 95 % intervals over scenes; every measure by scene. --real, --hard or both are needed.
    --quick takes the pair of either list that overlaps most, with few points.

    Exit code 0: all was measured. 2: bad usage, or a file that cannot be read.
    """
    from torchreg.benchmark.family.study import FamilyOptions, family_study

    expect_folder(out)
    opt.use(opt.Device.cpu, threads)
    options = FamilyOptions(
        real=real,
        hard=hard,
        fusions=names_in(fusions),
        scenes=names_in(scenes),
        effort=effort,
        every=every,
        points=points,
        quick=quick,
        seed=seed,
    )
    run_and_show(family_study(options), out)
