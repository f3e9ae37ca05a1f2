"""``torchreg site``: many scans into one frame."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

import typer

from torchreg.batch.described_file import computing_versions
from torchreg.batch.run_folder import expect_run_folder
from torchreg.cli import options as opt
from torchreg.cli.expand import expanded, option_of
from torchreg.cli.guard import NOT_REGISTERED, complain
from torchreg.cli.output import standard_output, write_json
from torchreg.cli.progress import batch_progress
from torchreg.cli.site_frame import HowToFrame, points_in_words, remove_control_csv, write_control_csv
from torchreg.cli.site_outputs import SiteOutputs, check_site_outputs, write_site_outputs
from torchreg.cli.wording import by_options
from torchreg.cli.work import Work, resumable
from torchreg.errors import one_of
from torchreg.io import Reading
from torchreg.io.formats import formats_in_words
from torchreg.io.placement import viewpoint_of_text
from torchreg.io.poses_csv import write_poses_csv
from torchreg.report.text import legible, plain
from torchreg.settings import LARGEST_READ, Settings
from torchreg.site.pairs import FEW_SCANS
from torchreg.site.result import SiteResult
from torchreg.site.run import Shard, SiteSettings, run_shard, run_site
from torchreg.site.site_json import site_to_dict
from torchreg.site.store import OF_SHARDS, SiteStore
from torchreg.verification import WORK

ScanPaths = Annotated[
    list[Path],
    typer.Argument(
        metavar="SCANS...",
        help=f"The files of the scans, coordinates in meters: {formats_in_words()}. A file with several scans gives "
        "all of them.",
    ),
]


@dataclass(frozen=True, kw_only=True)
class HowToRead:
    """How scans are read."""

    voxel: Annotated[
        float | None,
        typer.Option(
            "--voxel",
            metavar="METERS",
            help="Edge in meters of the cubes in which points are averaged while they are read; by default only "
            f"for scans of more than {LARGEST_READ:,} points.",
            rich_help_panel=opt.INPUT,
        ),
    ] = None
    viewpoint: opt.ViewpointText = "auto"
    columns: opt.ColumnsText = None
    units: opt.UnitsText = None
    intensity: Annotated[bool, option_of(Settings, "intensity")] = False

    def reading(self) -> Reading:
        """The same for all files."""
        return Reading(
            viewpoint=viewpoint_of_text(self.viewpoint, "--viewpoint"),
            columns=self.columns,
            units=self.units,
            voxel=self.voxel,
            at_most=None if self.voxel is not None else LARGEST_READ,
            intensity=self.intensity,
        )


@dataclass(frozen=True, kw_only=True)
class Sharing:
    """Which part of the work this run does."""

    shard: Annotated[
        str | None,
        typer.Option(
            "--shard",
            metavar="K/N",
            help="Register the Kth of N shares of the pairs and stop, as one job of an array; the same command without "
            "--shard then takes over what all of them found.",
            rich_help_panel=opt.RUN,
        ),
    ] = None

    def chosen(self) -> Shard | None:
        """The shard, if there is one."""
        return None if self.shard is None else Shard.of_text(self.shard, "--shard")


@expanded
def site(
    scans: ScanPaths,
    reading: HowToRead,
    wanted: HowToFrame,
    outputs: SiteOutputs,
    work: Work,
    sharing: Sharing,
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            metavar="FOLDER",
            help="Folder of the results, made if need be; an unfinished run there is resumed.",
            rich_help_panel=opt.OUTPUT,
        ),
    ],
    effort: Annotated[
        str | None,
        typer.Option(
            "--effort",
            metavar="|".join(WORK),
            help="Work spent per pair, as for torchreg register; by default balanced, and fast for sites of more than "
            f"{FEW_SCANS} scans.",
            rich_help_panel="Search",
        ),
    ] = None,
    seed: opt.Seed = 0,
) -> None:
    """Put many SCANS into one frame, in any order and without a first guess; all lengths are in meters.

    The same command resumes a run that was cut off: no finished pair is lost or computed again.

    FOLDER gets poses.csv (scan, group, m00 to m33: x_world = R x_scan + t, row by row, from the frame of each scan's
    file; empty where a scan is not placed) and site.json (poses with their covariances, every candidate of every pair
    with its verdict). Group 0 is the largest; groups that do not connect have frames of their own, level where half of
    the scans agree about up. Known poses and control points (control.csv: their residuals) fix the frame instead.

    Exit code 0: all scans are placed in one frame. 2: bad usage, or no scan can be read. 3: some scans are not placed
    or not in one frame; the results say which and why.
    """
    opt.use(work.device, None)
    if effort is not None:
        one_of(effort, "--effort", tuple(WORK))
    work.check()
    wanted.check()
    shard = sharing.chosen()
    check_site_outputs(outputs, [*scans, *wanted.files], out)
    wanted.check_tables()
    how = reading.reading()
    manifest = {
        **computing_versions(),
        "device": work.device.value,
        "effort": effort,
        "seed": seed,
        "reading": asdict(reading),
    }
    expect_run_folder(out, OF_SHARDS)
    folder = out if shard is None else shard.folder(out)
    folder.parent.mkdir(exist_ok=True, parents=shard is not None)
    with (
        closing(work.start()) as engine,
        SiteStore(folder, manifest) as store,
        resumable(out),
        batch_progress() as report,
    ):
        settings = SiteSettings(reading=how, effort=effort, seed=seed)
        described = work.folder(out)
        if shard is not None:
            count = run_shard(
                scans,
                store,
                engine,
                shard,
                described=described,
                settings=settings,
                max_bytes=work.max_bytes,
                report=report,
            )
            complain(f"{count:,} pairs are registered; the same command without --shard places the scans")
            return
        run = run_site(
            scans,
            store,
            engine,
            described=described,
            settings=settings,
            frame=lambda found: wanted.frame(found.names, found.posed),
            max_bytes=work.max_bytes,
            report=report,
        )
    result, names = run.result, run.found.names
    for name, trouble in run.found.unreadable():
        complain(by_options(trouble) if name in trouble else f"{name}: {by_options(trouble)}")
    result = replace(result, reason=_worded(result.reason), notes=tuple(map(_worded, result.notes)))
    write_poses_csv(out / "poses.csv", names, result.group, result.T_world_scan)
    write_json(out / "site.json", site_to_dict(result, names, seed=seed), through_link=False)
    written = [out / "poses.csv", out / "site.json"]
    with resumable(out):
        written += write_site_outputs(outputs, result, run.found, how, written)
    if result.control:
        write_control_csv(out / "control.csv", result.control, names)
        written.append(out / "control.csv")
    else:
        remove_control_csv(out / "control.csv")
    _show(result, names)
    for line in (*points_in_words(result.control, names), *result.remarks):
        complain(legible(line))
    complain(f"wrote {', '.join(map(str, written))}")
    if not bool(result.placed.all()) or int(result.group.max()) > 0:
        raise typer.Exit(NOT_REGISTERED)


def _worded(texts: Sequence[str]) -> tuple[str, ...]:
    return tuple(by_options(text) for text in texts)


def _show(result: SiteResult, names: Sequence[str]) -> None:
    from torchreg.report.site_text import summary_of

    standard_output().print(plain(summary_of(result, names)), soft_wrap=True)
