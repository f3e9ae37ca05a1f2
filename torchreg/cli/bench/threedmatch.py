"""``torchreg bench 3dmatch``: pairs of 3DMatch scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchreg.cli.bench.shared import ComparisonRun, Log, Out, expect_folder, run_and_show
from torchreg.cli.expand import expanded
from torchreg.errors import positive

Voxel = Annotated[
    float,
    typer.Option("--voxel", metavar="METERS", help="Average the points over cubes of this edge first, in meters."),
]
Scenes = Annotated[Path, typer.Argument(metavar="PATH", help="A scene of fragments, or a folder of scenes.")]


@expanded
def threedmatch(
    folder: Scenes,
    run: ComparisonRun,
    out: Out = Path("torchreg_3dmatch"),
    log: Log = None,
    voxel: Voxel = 0.05,
) -> None:
    """Register the pairs of 3DMatch, 3DLoMatch, Color3DMatch or ETH scenes, and print the tables that papers print.

    Fragments are cloud_bin_0.ply, ... (in ETH scenes Hokuyo_0.ply, ...) in one folder per scene, gt.log and gt.info in
    it or in SCENE-evaluation beside it. Registration recall at 0.2 meters by the information matrix over pairs that are
    not consecutive, feature-match recall at 0.1 meters and 5 %, inlier ratio, scene by scene and their mean.
    --quick takes the first pair that counts of each of two scenes.

    Exit code 0: all methods that are installed were measured. 2: bad usage, or a file that cannot be read.
    """
    from torchreg.benchmark.threedmatch.study import fragments_study

    expect_folder(out)
    study = fragments_study(folder, run.options(), log=log, voxel=positive(voxel, "--voxel"))
    run_and_show(study, out)
