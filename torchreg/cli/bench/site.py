"""``torchreg bench site``: sites of many scans."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchreg.benchmark.site.registry import SITE_METHODS
from torchreg.cli import options as opt
from torchreg.cli.bench.shared import Out, Quick, counts_in, expect_folder, names_in, run_and_show

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
BuildingSeeds = Annotated[
    int,
    typer.Option("--seeds", metavar="COUNT", min=0, help="Simulated buildings of each number of scans; 0 for none."),
]
BuildingScans = Annotated[
    str, typer.Option("--scans", metavar="COUNT,COUNT", help="Numbers of scans of the buildings, from 5 to 500.")
]
SiteNames = Annotated[str | None, typer.Option("--sites", metavar="NAME,NAME", help="Only the sites of these names.")]


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

    expect_folder(out)
    opt.use(opt.Device.cpu, threads)
    options = SiteBenchOptions(
        methods=names_in(methods),
        seeds=seeds,
        scans=counts_in(scans, "--scans", 5),
        data=tuple(data or ()),
        sites=names_in(sites),
        quick=quick,
        seed=seed,
    )
    run_and_show(site_study(options), out)
