"""``torchreg bench speed``: times of every stage."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchreg.cli import options as opt
from torchreg.cli.bench.shared import Out, Quick, counts_in, expect_folder, run_and_show
from torchreg.errors import expect_in_words, positive

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

    expect_folder(out)
    place = opt.use(device, threads)
    on_cpu = place.type == "cpu"
    expect_in_words(data is None or on_cpu, "--data", "--device cpu beside it, where peers run", f"--device {place}")
    expect_in_words(seconds is None or not on_cpu, "--seconds", "--device cuda beside it", f"--device {place}")
    counts = (POINTS if on_cpu else DEVICE_POINTS) if points is None else counts_in(points, "--points", 100)
    if on_cpu:
        study = speed_study(counts, repeats=repeats, quick=quick, data=data)
    else:
        limit = SECONDS if seconds is None else positive(seconds, "--seconds")
        study = device_study(counts, DeviceRun(device=place, repeats=repeats, seconds=limit, quick=quick))
    run_and_show(study, out)
