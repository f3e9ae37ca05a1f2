"""``torchreg verify``: judge a transform between two files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from torchreg.cli import options as opt
from torchreg.cli.expand import expanded
from torchreg.cli.guard import NOT_REGISTERED, complain
from torchreg.cli.output import STANDARD_OUTPUT, Output, check_outputs, standard_output, write_json
from torchreg.cli.pair import CloudArguments, options_of_pair, read_pair
from torchreg.cli.progress import step
from torchreg.errors import one_of
from torchreg.io import read_transform_text
from torchreg.registration.verify import verify as verify_transforms
from torchreg.settings import Settings
from torchreg.verification import WORK


@dataclass(frozen=True, kw_only=True)
class GivenArguments(CloudArguments):
    """The files of two clouds and of the transform between them."""

    transform: Annotated[
        Path,
        typer.Argument(
            metavar="TRANSFORM",
            help="The transform to judge, as four lines of four numbers or JSON of `torchreg register`: "
            "x_target = R x_source + t, in meters.",
        ),
    ]


@expanded
def verify(
    files: GivenArguments,
    settings: Settings,
    json: opt.JsonFile = None,
    explain: Annotated[
        bool,
        typer.Option(
            "--explain",
            help="Print after the table what each stage kept and dropped, what speaks for and against the transform, "
            "and what may help.",
            rich_help_panel=opt.OUTPUT,
        ),
    ] = False,
    device: opt.DeviceName = opt.Device.cpu,
    threads: opt.Threads = None,
) -> None:
    """Judge a TRANSFORM that brings SOURCE onto TARGET: how probable is it that it is right, what speaks against it?

    The poses that `torchreg register` would find compete with it. Exit code 0: right. 2: bad usage or an unreadable
    file. 3: not right, with the reason.
    """
    from torchreg.io import verification_to_dict
    from torchreg.report import verification_table
    from torchreg.report.text import plain

    check_outputs((Output("--json", json),), [files.source, files.target, files.transform])
    if settings.effort is not None:
        one_of(settings.effort, "--effort", tuple(WORK))
    where = opt.use(device, threads)
    T = read_transform_text(files.transform)
    pair, seed = read_pair(files, settings), settings.seed
    with step(f"judging {files.transform.name}"):
        source, target = pair.used[0].to(where), pair.used[1].to(where)
        result = verify_transforms(source, target, T, options_of_pair(source, target, settings), seed=seed)
    success, reason = bool(result.success[0]), result.reason[0]
    if json is not None:
        content = verification_to_dict(result, seed=seed, source=str(files.source), target=str(files.target))
        run = {name: getattr(settings, name) for name in ("preset", "points", "viewpoint")} | {"device": device.value}
        more = {"transform": str(files.transform), "points": pair.counts(), "file_notes": pair.notes(), "run": run}
        write_json(json, {**content, **more})
    if json == STANDARD_OUTPUT:
        complain("right" if success else f"not right: {reason}")
    else:
        words = pair.words
        notes = [f"{side}: {note}" for side, notes in pair.notes().items() for note in notes]
        table = verification_table(
            result, source=words[0], target=words[1], given=str(files.transform), file_notes=notes
        )
        standard_output().print(table)
    if explain:
        console = standard_output(stderr=json == STANDARD_OUTPUT)
        console.print("", plain(result.explain()), sep="\n", soft_wrap=True)
    if not success:
        raise typer.Exit(NOT_REGISTERED)
