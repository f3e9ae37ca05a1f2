"""``torchreg bench features``: anyone's features."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchreg.cli.bench.shared import ComparisonRun, Log, Out, expect_folder, run_and_show
from torchreg.cli.expand import expanded
from torchreg.errors import positive

Adapters = Annotated[
    list[str] | None,
    typer.Argument(metavar="MODULE:CALLABLE", help="Adapters, imported from the working directory or the environment."),
]
FeatureData = Annotated[
    Path,
    typer.Option(
        "--data",
        metavar="PATH",
        help="List of pairs (JSON), or the folder with its pairs.json; or scenes of fragments, as Color3DMatch.",
    ),
]
InMeters = Annotated[
    bool, typer.Option("--meters", help="Bounds of 0.2 and 0.1 meters for every pair of a list, not by its voxels.")
]
AnyVoxel = Annotated[
    float | None,
    typer.Option(
        "--voxel",
        metavar="METERS",
        help="Average the points over cubes of this edge first, in meters; the list's, or 0.05, by default.",
    ),
]


@expanded
def features(
    data: FeatureData,
    run: ComparisonRun,
    adapters: Adapters = None,
    out: Out = Path("torchreg_features"),
    meters: InMeters = False,
    log: Log = None,
    voxel: AnyVoxel = None,
) -> None:
    """Measure your own network's features, or its matches, beside FPFH on pairs of known truth.

    An adapter takes one cloud and returns features (P, D) of its points, or takes source and target and returns both
    features, or matches (M, 2); a class is made without arguments. Poses follow from all features in the same way.
    Registration recall by RMSE, feature-match recall and inlier ratio, by scene and by overlap, as on 3DMatch and
    Color3DMatch; of scenes of fragments, the tables of `torchreg bench 3dmatch`. --methods names what else runs beside:
    the default, unless it is given. --quick takes one pair of each of two scenes.

    An unfinished run is resumed: for other weights under the same name take another --out.

    Exit code 0: all was measured. 2: bad usage, or a file or an adapter that cannot be read.
    """
    from torchreg.benchmark.features.study import features_study

    expect_folder(out)
    edge = None if voxel is None else positive(voxel, "--voxel")
    study = features_study(adapters or (), data, run.options(), in_meters=meters, log=log, voxel=edge)
    run_and_show(study, out)
