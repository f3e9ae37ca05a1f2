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
        help="Also train on the pairs of this list (JSON), or of pairs.json in this folder: under pairs, objects with "
        "name, scene, source, target, T, voxel_m and overlap. May be given several times.",
        rich_help_panel=opt.INPUT,
    ),
]
HoldOut = Annotated[
    str | None,
    typer.Option(
        "--hold-out",
        metavar="SCENE,SCENE",
        help="Scenes of the lists that are not trained on and judge the network; by default every third, in the order "
        "of their names, beginning with the first.",
        rich_help_panel=opt.INPUT,
    ),
]
Places = Annotated[
    int,
    typer.Option(
        "--places",
        metavar="COUNT",
        min=0,
        help="How many simulated malls, roads and office buildings to train on, each; two more of each are held out.",
        rich_help_panel=opt.INPUT,
    ),
]
Steps = Annotated[int, typer.Option("--steps", metavar="COUNT", min=1, help="Steps of training, each on one pair.")]
ViewPoints = Annotated[
    int, typer.Option("--points", metavar="COUNT", min=20, help="About how many points of each scan a step takes.")
]
Every = Annotated[
    int,
    typer.Option(
        "--every", metavar="COUNT", min=1, help="Steps from one checkpoint, and one line of the log, to the next."
    ),
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

    Each step takes another view of a pair (moved, cropped, thinned, noisy, in other light) and asks of every point
    which point of the other scan is its true partner. At the end the held-out pairs are matched by the network's
    features, by these beside the default's, by FPFH, by the default's and by LEARNED. Tables say, by group, how many
    matches are right within two voxels, which share of all that is (the inlier ratio), and in which share of the pairs
    it is above 5 % (feature-match recall). The log has the inlier ratio of one held-out pair of every group. All
    lengths follow from the voxels of a pair.

    The defaults take about half an hour on one core. Exit code 0: trained and judged. 2: bad usage, or a file that
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
