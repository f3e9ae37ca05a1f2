"""``torchreg train``: a network for features, on simulated places and listed pairs, judged on held-out scenes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from statistics import fmean
from typing import Annotated

import typer
from rich.table import Table

from torchreg.batch import BatchProgress
from torchreg.cli import options as opt
from torchreg.cli.guard import complain
from torchreg.cli.output import standard_output
from torchreg.cli.progress import batch_progress, step
from torchreg.cli.training_data import TrainingData, training_data
from torchreg.cli.training_folder import Board, LogRow, TrainingFolder
from torchreg.errors import expect
from torchreg.learning.held_out import MatchQuality, baselines, by_group, match_quality, network_features
from torchreg.learning.network_training import NetworkTraining, NetworkTrainingOptions
from torchreg.learning.posed_pairs import PosedPair
from torchreg.report.text import legible

Out = Annotated[
    Path,
    typer.Option(
        "--out",
        metavar="FOLDER",
        help="Folder of the run: weights.pt, checkpoint.pt, log.csv, held_out.csv, held_out.json. An unfinished run "
        "there is resumed, to the same bits.",
        rich_help_panel=opt.OUTPUT,
    ),
]
Pairs = Annotated[
    list[Path] | None,
    typer.Option(
        "--pairs",
        metavar="PATH",
        help="Also the pairs of this list (JSON), or of the folder's pairs.json: under pairs, objects with name, "
        "scene, source, target, T, voxel_m and overlap. May be given several times.",
        rich_help_panel=opt.INPUT,
    ),
]
HoldOut = Annotated[
    str | None,
    typer.Option(
        "--hold-out",
        metavar="SCENE,SCENE",
        help="Scenes of the lists to judge by and not to train on; by default every third, in the order of their "
        "names, the first among them.",
        rich_help_panel=opt.INPUT,
    ),
]
Places = Annotated[
    int,
    typer.Option(
        "--places",
        metavar="COUNT",
        min=0,
        help="Simulated malls, roads and office buildings to train on, so many of each; two more of each are held out.",
        rich_help_panel=opt.INPUT,
    ),
]
Steps = Annotated[int, typer.Option("--steps", metavar="COUNT", min=1, help="Steps of training, a pair each.")]
ViewPoints = Annotated[
    int, typer.Option("--points", metavar="COUNT", min=20, help="Points of a part of a pair, about, of either scan.")
]
Every = Annotated[
    int, typer.Option("--every", metavar="COUNT", min=1, help="Steps between two checkpoints and lines of the log.")
]

Show = Callable[[BatchProgress], None]


def train(
    out: Out,
    pairs: Pairs = None,
    hold_out: HoldOut = None,
    places: Places = 20,
    steps: Steps = NetworkTrainingOptions.steps,
    points: ViewPoints = NetworkTrainingOptions.points,
    every: Every = 200,
    seed: opt.Seed = 0,
    device: opt.DeviceName = opt.Device.cpu,
    threads: opt.Threads = None,
) -> None:
    """Train a network that maps points to features, and judge it on scenes that it never saw.

    Views of the pairs (moved, cropped, thinned, noisy, in other light) are matched by contrast: of all points the true
    partner should be the most similar. At last the mutual matches of all held-out pairs are judged, by the network's
    features, alone and beside the default's, by FPFH, by the default's and by LEARNED: the share that is right within
    two voxels, how many are, and the share of pairs with more than 5 % right (feature-match recall), by group. The log
    has the first of these for one held-out pair of every group. Lengths are those of every pair's voxels.

    The defaults take about half an hour of one core. Exit code 0: trained and judged. 2: bad usage, or a file that
    cannot be read.
    """
    fits = out.is_dir() or (not out.exists() and out.absolute().parent.is_dir())
    expect(fits, "--out", "a folder, or a name for one in a folder that exists", str(out))
    place = opt.use(device, threads)
    names = None if hold_out is None else [name.strip() for name in hold_out.split(",") if name.strip()]
    data = training_data(places, pairs or [], names)
    options = NetworkTrainingOptions(steps=steps, points=points, seed=seed)
    listed = [str(path.resolve()) for path in pairs or []]
    run = {"pairs": listed, "held_out": data.held_out_scenes, "places": places, "every": every, **asdict(options)}
    folder = TrainingFolder(out, run)
    checkpoint = folder.checkpoint()
    with step("reading and simulating scans"):
        training = NetworkTraining(list(data.to_train_on()), options, device=place)
        validation = data.to_validate_on()
    if checkpoint is not None:
        training.load_state_dict(checkpoint)
        complain(f"resumed at step {training.done:,} of {steps:,}")
    with batch_progress() as show:
        _train(training, validation, folder, every, show)
        qualities = _judged(training, data, show)
    folder.keep_held_out(qualities)
    console = standard_output()
    if qualities:
        console.print(_table(qualities))
    else:
        console.print("No pair was held out: nothing was judged.")
    console.print(f"Weights: {legible(str(out / 'weights.pt'))}", soft_wrap=True)


def _train(
    training: NetworkTraining, validation: Sequence[PosedPair], folder: TrainingFolder, every: int, show: Show
) -> None:
    """The steps that are left; a checkpoint and a line of the log every so many, and at the end."""
    board, losses, steps = Board(folder.path), list[float](), training.options.steps
    while training.done < steps:
        losses.append(training.step())
        show(BatchProgress("train", training.done, steps))
        if training.done % every == 0 or training.done == steps:
            methods = {"network": network_features(training.network)["network"]}
            ratios = [one.inlier_ratio for one in match_quality(methods, validation)]
            ratio = fmean(ratios) if ratios else float("nan")
            folder.keep(training, LogRow(training.done, fmean(losses), training.rate, ratio))
            board.show(folder.log[-1])
            losses.clear()


def _judged(training: NetworkTraining, data: TrainingData, show: Show) -> list[MatchQuality]:
    """All held-out pairs by all features."""
    methods = {**baselines(), **network_features(training.network)}
    qualities: list[MatchQuality] = []
    for number, posed in enumerate(data.to_judge()):
        qualities += match_quality(methods, [posed])
        show(BatchProgress("judge", number + 1, data.judged))
    return qualities


def _table(qualities: Sequence[MatchQuality]) -> Table:
    table = Table("held-out group", "features", "pairs", "inlier ratio", "inliers", "matched", title_justify="left")
    last = None
    for row in by_group(qualities):
        cells = row.features, f"{row.pairs}", f"{row.inlier_ratio:.3f}", f"{row.inliers:,.1f}"
        table.add_row("" if row.group == last else row.group, *cells, f"{row.feature_match_recall:.0%}")
        last = row.group
    return table
