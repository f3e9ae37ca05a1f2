"""``torchreg bench``: measurements that anyone can repeat, one study per command."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from torchreg.benchmark.core.study import Study, run_study
from torchreg.benchmark.core.tables import narrow_parts
from torchreg.benchmark.peers import METHODS
from torchreg.benchmark.peers.comparison import ComparisonOptions
from torchreg.benchmark.site.registry import SITE_METHODS
from torchreg.cli import options as opt
from torchreg.cli.expand import expanded
from torchreg.cli.guard import GuardedGroup, complain
from torchreg.cli.output import standard_output
from torchreg.errors import at_least, expect, positive
from torchreg.report.text import legible

bench = typer.Typer(
    cls=GuardedGroup,
    no_args_is_help=True,
    help="Measure torchreg and its peers: on real pairs, on 3DMatch, on sites of many scans, the paper's experiments, "
    "speed. Each command writes a folder with NAME.md (all tables and pictures), CSV, and NAME.json.",
)

Out = Annotated[
    Path,
    typer.Option(
        "--out",
        metavar="FOLDER",
        help="Folder of all results: NAME.md, CSV, NAME.json, pictures. An unfinished run there is resumed.",
    ),
]
Quick = Annotated[bool, typer.Option("--quick", help="Run a small part, within seconds, to see how it works.")]
Data = Annotated[
    Path, typer.Option("--data", metavar="PATH", help="List of pairs (JSON), or the folder with its pairs.json.")
]
Scenes = Annotated[Path, typer.Argument(metavar="PATH", help="A scene of fragments, or a folder of scenes.")]
Log = Annotated[
    Path | None,
    typer.Option(
        "--log",
        metavar="NAME|FOLDER",
        help="The log that lists the pairs: the name of a file in each scene or beside it, or a folder with "
        "SCENE/gt.log for each, as 3DLoMatch comes; gt.log by default.",
    ),
]
Voxel = Annotated[
    float,
    typer.Option("--voxel", metavar="METERS", help="Average the points over cubes of this edge first, in meters."),
]
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
Experiments = Annotated[
    list[int] | None,
    typer.Option(
        "--experiment",
        metavar="1..5",
        min=1,
        max=5,
        help="Only this experiment, from 1 to 5; may be given several times.",
    ),
]
Seeds = Annotated[
    int | None,
    typer.Option(
        "--seeds",
        metavar="COUNT",
        min=1,
        help="Number of simulated malls and roads: 10, or 1 with --quick, by default.",
    ),
]
Real = Annotated[
    Path | None,
    typer.Option(
        "--real",
        metavar="PATH",
        help="Also on the real pairs of this list, or of the folder's pairs.json: those with colors and much overlap.",
    ),
]
Points = Annotated[
    str | None,
    typer.Option(
        "--points",
        metavar="COUNT,COUNT",
        help="Numbers of points of each cloud; by default 1,000 to 1,000,000, on a GPU 10,000 to 10,000,000.",
    ),
]
Seconds = Annotated[
    float | None,
    typer.Option(
        "--seconds",
        metavar="NUMBER",
        help="Time of a run on a GPU, a whole number of seconds; 400 by default.",
    ),
]
Repeats = Annotated[
    int, typer.Option("--repeats", metavar="COUNT", min=1, help="Number of counted runs of everything.")
]

BusyData = Annotated[
    Path | None,
    typer.Option(
        "--data",
        metavar="PATH",
        help="Also whole methods on the real pairs of this list, or of the folder's pairs.json: alone, and beside a "
        "process that keeps one core busy.",
    ),
]
SiteData = Annotated[
    list[Path] | None,
    typer.Option(
        "--data",
        metavar="PATH",
        help="Also the real sites here: a folder with a site.json, a folder of such folders, or a list of pairs "
        "(JSON), of which the clouds of a scene are a site; may be given several times.",
    ),
]
SiteMethods = Annotated[
    str | None, typer.Option("--methods", metavar="NAME,NAME", help=f"Only these: {', '.join(SITE_METHODS)}.")
]
SiteNames = Annotated[str | None, typer.Option("--sites", metavar="NAME,NAME", help="Only the sites of these names.")]
BuildingSeeds = Annotated[
    int,
    typer.Option("--seeds", metavar="COUNT", min=0, help="Simulated buildings of each number of scans; 0 for none."),
]
BuildingScans = Annotated[
    str, typer.Option("--scans", metavar="COUNT,COUNT", help="Numbers of scans of the buildings, from 5 to 500.")
]


@dataclass(frozen=True, kw_only=True)
class ComparisonRun:
    """Which methods are compared on which scenes, and how they run."""

    methods: Annotated[
        str | None,
        typer.Option(
            "--methods",
            metavar="NAME,NAME",
            help=f"Only these: {', '.join(METHODS)}.",
        ),
    ] = None
    scenes: Annotated[
        str | None, typer.Option("--scenes", metavar="NAME,NAME", help="Only the pairs of these scenes.")
    ] = None
    quick: Quick = False
    seed: opt.Seed = 0
    device: opt.DeviceName = opt.Device.cpu
    threads: opt.Threads = None

    def options(self) -> ComparisonOptions:
        """The same for a study; sets PyTorch's threads.

        Raises:
            ValueError: a GPU is asked for and PyTorch finds none.
        """
        return ComparisonOptions(
            methods=_names(self.methods),
            scenes=_names(self.scenes),
            quick=self.quick,
            device=opt.use(self.device, self.threads).type,
            seed=self.seed,
        )


@bench.command()
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

    _expect_folder(out)
    _run_and_show(field_study(data, run.options()), out)


@bench.command("3dmatch")
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

    _expect_folder(out)
    study = fragments_study(folder, run.options(), log=log, voxel=positive(voxel, "--voxel"))
    _run_and_show(study, out)


@bench.command()
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

    _expect_folder(out)
    edge = None if voxel is None else positive(voxel, "--voxel")
    study = features_study(adapters or (), data, run.options(), in_meters=meters, log=log, voxel=edge)
    _run_and_show(study, out)


@bench.command()
def site(
    out: Out = Path("torchreg_site"),
    data: SiteData = None,
    seeds: BuildingSeeds = 3,
    scans: BuildingScans = "15,30,60",
    sites: SiteNames = None,
    methods: SiteMethods = None,
    quick: Quick = False,
    seed: opt.Seed = 0,
    threads: opt.Threads = None,
) -> None:
    """Compare torchreg with Open3D's multiway registration on simulated buildings and real sites of many scans.

    Share of pairs of scans with the right relative pose (5 degrees, 6 voxels), scans placed wrongly or not at all,
    errors in millimeters and degrees, share of the pairs that were tried, seconds. --quick takes one floor with five
    scans, and of the real sites that of the fewest.

    Exit code 0: all was measured. 2: bad usage, or a file that cannot be read.
    """
    from torchreg.benchmark.site.study import SiteBenchOptions, site_study

    _expect_folder(out)
    opt.use(opt.Device.cpu, threads)
    options = SiteBenchOptions(
        methods=_names(methods),
        seeds=seeds,
        scans=_counts(scans, "--scans", 5),
        data=tuple(data or ()),
        sites=_names(sites),
        quick=quick,
        seed=seed,
    )
    _run_and_show(site_study(options), out)


@bench.command()
def paper(
    out: Out = Path("torchreg_paper"),
    experiment: Experiments = None,
    seeds: Seeds = None,
    real: Real = None,
    quick: Quick = False,
    seed: opt.Seed = 0,
    device: opt.DeviceName = opt.Device.cpu,
    threads: opt.Threads = None,
) -> None:
    """Run the paper's five experiments, and write its Tables 5 to 9 with our numbers beside its own.

    Experiments: 1 three initial poses at 10,000 points, 2 12,000 points against 4,000, 3 4,000 down to 500 points, 4
    times with and without color, 5 an outdoor road. FPFH alone, FPFH + PCFH, and the same without histogram
    equalization, on simulated scans and, with --real, on real ones; all lengths in meters. --quick takes a quarter of
    the points and coarse scans.

    Exit code 0: all was measured. 2: bad usage, or a file that cannot be read.
    """
    from torchreg.benchmark.paper.settings import EXPERIMENTS
    from torchreg.benchmark.paper.study import paper_study

    _expect_folder(out)
    study = paper_study(
        tuple(sorted(set(experiment))) if experiment else EXPERIMENTS,
        seeds=seeds or (1 if quick else 10),
        seed=seed,
        real=real,
        quick=quick,
        device=opt.use(device, threads).type,
    )
    _run_and_show(study, out)


@bench.command()
def speed(
    out: Out = Path("torchreg_speed"),
    points: Points = None,
    repeats: Repeats = 5,
    quick: Quick = False,
    data: BusyData = None,
    device: opt.DeviceName = opt.Device.cpu,
    seconds: Seconds = None,
    threads: opt.Threads = None,
) -> None:
    """Time every stage and the whole pair against Open3D's classic and tensor pipelines, in one process.

    Seconds over numbers of points, neighbors and hypotheses, how they grow (slopes of logarithms), and peak memory;
    torchreg eager and compiled. Then batches of small pairs, a pair of 100,000 matches, a million points described,
    and with --data whole methods, quiet and busy. --quick takes few points and two repeats.

    With --device cuda: every stage, the whole pair and its memory up to 10,000,000 points, pairs a second in batches of
    up to 4,096, beside Open3D's CUDA tensors and cuVS where they are installed; what does not fit the memory or
    --seconds is left out, and the tables say so.

    Exit code 0: all was measured. 2: bad usage.
    """
    from torchreg.benchmark.speed.device import DEVICE_POINTS, SECONDS, DeviceRun, device_study
    from torchreg.benchmark.speed.grid import POINTS
    from torchreg.benchmark.speed.study import speed_study

    _expect_folder(out)
    place = opt.use(device, threads)
    on_cpu = place.type == "cpu"
    expect(data is None or on_cpu, "--data", "--device cpu beside it, where peers run", f"--device {place}")
    expect(seconds is None or not on_cpu, "--seconds", "--device cuda beside it", f"--device {place}")
    counts = (POINTS if on_cpu else DEVICE_POINTS) if points is None else _counts(points, "--points", 100)
    if on_cpu:
        study = speed_study(counts, repeats=repeats, quick=quick, data=data)
    else:
        limit = SECONDS if seconds is None else positive(seconds, "--seconds")
        study = device_study(counts, DeviceRun(device=place, repeats=repeats, seconds=limit, quick=quick))
    _run_and_show(study, out)


def _run_and_show(study: Study, out: Path) -> None:
    """Run, and print what the study shows and where the rest lies."""
    from rich.table import Table

    rows = run_study(study, out, report=complain)
    console = standard_output()
    for shown in study.shown(rows):
        if isinstance(shown, str):
            console.print(shown)
            continue
        for part in narrow_parts(shown, console.width):
            table = Table(*part.head, title=part.heading or None, title_justify="left")
            for row in part.rows:
                table.add_row(*row)
            console.print(table)
    console.print(f"All tables: {legible(str(out / study.name))}.md", soft_wrap=True)


def _expect_folder(out: Path) -> None:
    """Raise ``ValueError`` where ``--out`` is neither a folder nor a name for one in a folder that exists."""
    fits = out.is_dir() or (not out.exists() and out.absolute().parent.is_dir())
    expect(fits, "--out", "a folder, or a name for one in a folder that exists", str(out))


def _names(text: str | None) -> tuple[str, ...] | None:
    """Names out of a text with commas between them."""
    return None if text is None else tuple(name.strip() for name in text.split(",") if name.strip())


def _counts(text: str, option: str, lowest: int) -> tuple[int, ...]:
    """Ascending counts out of a text with commas between them, each at least ``lowest``."""
    words = [word.strip() for word in text.split(",")]
    expect(all(word.isdigit() for word in words), option, "counts, a comma between two", text)
    return tuple(sorted({at_least(int(word), option, lowest) for word in words}))
