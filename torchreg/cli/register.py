"""``torchreg register``: find the transform between two files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from torch import Tensor

from torchreg.cli import options as opt
from torchreg.cli.expand import expanded
from torchreg.cli.guard import NOT_REGISTERED, complain
from torchreg.cli.output import STANDARD_OUTPUT, Output, check_outputs, standard_output, write_json
from torchreg.cli.pair import PairArguments, ReadPair, options_of_pair, read_pair
from torchreg.cli.progress import step
from torchreg.errors import expect, expect_in_words, one_of
from torchreg.io.formats import WRITERS, alternatives
from torchreg.io.transform_formats import TRANSFORM_FORMATS
from torchreg.metrics import PoseErrors, pose_errors
from torchreg.registration.register import register as register_clouds
from torchreg.report import FIGURE_SUFFIXES, REPORT_SUFFIXES
from torchreg.settings import Settings
from torchreg.types import RegistrationResult
from torchreg.verification.likeliest import likeliest_pose

_FIGURES = alternatives(FIGURE_SUFFIXES)


@dataclass(frozen=True, kw_only=True)
class Outputs:
    """What ``register`` writes and prints where it is asked for."""

    json: opt.JsonFile = None
    transform: Annotated[
        Path | None,
        typer.Option(
            "--transform",
            metavar="FILE.txt",
            help="Write the transform as four lines of four numbers, its translation in meters; not written if the "
            "pair is refused.",
            rich_help_panel=opt.OUTPUT,
        ),
    ] = None
    transform_format: Annotated[
        str,
        typer.Option(
            "--transform-format",
            metavar="|".join(TRANSFORM_FORMATS),
            help="Convention in which --transform writes. matrix: four lines of four numbers. cloudcompare: the same "
            "with 12 decimals. quaternion-wxyz, quaternion-xyzw: with the real part first or last, and the "
            "translation. euler-zyx: degrees, R = Rz(yaw) Ry(pitch) Rx(roll). e57: the pose of a scan. ptx: the lines "
            "of a header. pdal: a pipeline with filters.transformation.",
            rich_help_panel=opt.OUTPUT,
        ),
    ] = "matrix"
    aligned: Annotated[
        Path | None,
        typer.Option(
            "--aligned",
            metavar="FILE.ply",
            help="Write the whole source in the frame of the target, coordinates in meters, as a "
            f"{alternatives(WRITERS)} file; points that were averaged while they were read stay so. Not written "
            "if the pair is refused.",
            rich_help_panel=opt.OUTPUT,
        ),
    ] = None
    force: Annotated[
        bool,
        typer.Option(
            "--force",
            help="Write --transform and --aligned of a refused pair too, by its likeliest pose, which is not trusted.",
            rich_help_panel=opt.OUTPUT,
        ),
    ] = False
    figure: Annotated[
        Path | None,
        typer.Option(
            "--figure",
            metavar="FILE.png",
            help="Draw both clouds before and after (of a refused pair: under its likeliest pose), from three sides, "
            f"axes in meters, as a {_FIGURES} file.",
            rich_help_panel=opt.OUTPUT,
        ),
    ] = None
    matches: Annotated[
        Path | None,
        typer.Option(
            "--matches",
            metavar="FILE.png",
            help=f"Draw the matches between both clouds, inliers beside outliers, axes in meters, as a {_FIGURES} "
            "file.",
            rich_help_panel=opt.OUTPUT,
        ),
    ] = None
    report: Annotated[
        Path | None,
        typer.Option(
            "--report",
            metavar="FILE.html",
            help="Write one page with verdict, numbers, pictures and both clouds in 3D, lengths in meters, as a "
            f"{alternatives(REPORT_SUFFIXES)} file that opens without a network.",
            rich_help_panel=opt.OUTPUT,
        ),
    ] = None
    explain: Annotated[
        bool,
        typer.Option(
            "--explain",
            help="Print after the table what each stage kept and dropped, which poses were weighed and what may help.",
            rich_help_panel=opt.OUTPUT,
        ),
    ] = False

    def check(self, inputs: list[Path]) -> None:
        """Check before the work begins that all of them can be written."""
        one_of(self.transform_format, "--transform-format", tuple(TRANSFORM_FORMATS))
        idle = self.transform is None and self.transform_format != "matrix"
        expect(not idle, "--transform-format", "--transform beside it", self.transform_format)
        forced = not self.force or self.transform is not None or self.aligned is not None
        expect_in_words(forced, "--force", "--transform or --aligned beside it", "neither")
        outputs = (
            Output("--json", self.json),
            Output("--transform", self.transform),
            Output("--aligned", self.aligned, tuple(WRITERS)),
            Output("--figure", self.figure, FIGURE_SUFFIXES),
            Output("--matches", self.matches, FIGURE_SUFFIXES),
            Output("--report", self.report, REPORT_SUFFIXES),
        )
        check_outputs(outputs, inputs)

    def by_pose(self) -> list[Path]:
        """The files that only a pose can fill."""
        return [path for path in (self.transform, self.aligned) if path is not None]


@expanded
def register(
    files: PairArguments,
    settings: Settings,
    outputs: Outputs,
    device: opt.DeviceName = opt.Device.cpu,
    threads: opt.Threads = None,
) -> None:
    """Find the rigid transform that brings SOURCE onto TARGET: x_target = R x_source + t, in meters.

    No first guess is needed. Exit code 0: registered. 2: bad usage or an unreadable file. 3: refused, with the reason;
    no transform and no aligned cloud is written then without --force, and JSON has the likeliest pose, where there is
    one, as likeliest_T_target_source. Files that were written are named on standard error.
    """
    from torchreg.io import result_to_dict
    from torchreg.report import registration_table
    from torchreg.report.text import plain

    outputs.check(files.paths)
    where = opt.use(device, threads)
    T_true = files.transform()
    pair, seed = read_pair(files, settings), settings.seed
    with step(f"registering {files.source.name} to {files.target.name}"):
        source, target = pair.used[0].to(where), pair.used[1].to(where)
        options = options_of_pair(source, target, settings)
        result = register_clouds(source, target, options, seed=seed)
    success, reason, T = bool(result.success[0]), result.reason[0], likeliest_pose(result)
    T = None if T is None else T.cpu()
    errors = pose_errors(pair.whole[0], T_true, T) if T_true is not None and T is not None else None

    written = []
    if outputs.json is not None:
        content = result_to_dict(result, seed=seed, source=str(files.source), target=str(files.target))
        run = {name: getattr(settings, name) for name in ("preset", "points", "viewpoint")} | {"device": device.value}
        truth = None if errors is None else errors._asdict()
        write_json(
            outputs.json, {**content, "points": pair.counts(), "file_notes": pair.notes(), "run": run, "truth": truth}
        )
        written += [outputs.json] if outputs.json != STANDARD_OUTPUT else []
    written += _write_by_pose(outputs, pair, T, success=success)
    written += _draw(outputs, pair, result, T, f"{files.source.name} to {files.target.name}")
    if outputs.report is not None:
        _report(outputs.report, files, pair, result, errors)
        written.append(outputs.report)
    if outputs.json == STANDARD_OUTPUT:
        complain("registered" if success else f"not registered: {reason}")
    else:
        words = pair.words
        table = registration_table(
            result, source=words[0], target=words[1], truth=errors, file_notes=pair.sided_notes()
        )
        standard_output().print(table)
    if outputs.explain:
        console = standard_output(stderr=outputs.json == STANDARD_OUTPUT)
        console.print("", plain(result.explain()), sep="\n", soft_wrap=True)
    if written:
        complain(f"wrote {', '.join(map(str, written))}")
    if not success:
        raise typer.Exit(NOT_REGISTERED)


def _write_by_pose(outputs: Outputs, pair: ReadPair, T: Tensor | None, *, success: bool) -> list[Path]:
    """Write the transform and the source under it, of a pair that was registered or by force; returns the files."""
    from torchreg.io import write_cloud, write_transform_text

    paths = outputs.by_pose()
    if not paths:
        return []
    names = " and ".join(map(str, paths))
    if T is None:
        complain(f"{names} not written: no pose was found")
        return []
    if not success and not outputs.force:
        complain(f"{names} not written: the pair was refused (--force writes by its likeliest pose)")
        return []
    if not success:
        complain(f"note: {names} by the likeliest pose of a refused pair, which is not trusted")
    if outputs.transform is not None:
        write_transform_text(outputs.transform, T, form=outputs.transform_format)
    if outputs.aligned is not None:
        with step(f"writing {outputs.aligned.name}"):
            write_cloud(outputs.aligned, pair.whole[0], T=T)
    return paths


def _draw(outputs: Outputs, pair: ReadPair, result: RegistrationResult, T: Tensor | None, names: str) -> list[Path]:
    """Draw the pictures that are asked for; returns their files."""
    from torchreg.report import correspondence_figure, picture_title, registration_figure, save_figure

    title = picture_title(names, result)
    if outputs.figure is not None:
        with step(f"drawing {outputs.figure.name}"):
            figure = registration_figure(*pair.whole, T, title=title, refused=not bool(result.success[0]))
            save_figure(figure, outputs.figure)
    if outputs.matches is not None:
        with step(f"drawing {outputs.matches.name}"):
            save_figure(correspondence_figure(*pair.used, result, title=title), outputs.matches)
    return [path for path in (outputs.figure, outputs.matches) if path is not None]


def _report(
    path: Path, files: PairArguments, pair: ReadPair, result: RegistrationResult, errors: PoseErrors | None
) -> None:
    from torchreg.report import write_report

    names = (files.source.name, files.target.name)
    with step(f"writing {path.name}"):
        write_report(
            *(path, result, *pair.whole), names=names, words=pair.words, file_notes=pair.sided_notes(), truth=errors
        )
