"""What several commands take beside settings, as types: ``seed: Seed = 0`` in a command is the option ``--seed``."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import torch
import typer

from torchreg.cli.expand import option_of
from torchreg.errors import expect_in_words
from torchreg.settings import Settings

INPUT, RUN, OUTPUT = "Input", "Run", "Output"
"""Headings of help texts."""


class Device(str, Enum):
    """Where tensors are computed."""

    cpu = "cpu"
    cuda = "cuda"


ViewpointText = Annotated[str, option_of(Settings, "viewpoint")]
ScanText = Annotated[str | None, option_of(Settings, "scan")]
ColumnsText = Annotated[str | None, option_of(Settings, "columns")]
UnitsText = Annotated[str | None, option_of(Settings, "units")]
Seed = Annotated[int, option_of(Settings, "seed")]
DeviceName = Annotated[
    Device, typer.Option("--device", help="Where to compute: cpu, or cuda for a GPU.", rich_help_panel=RUN)
]
Threads = Annotated[
    int | None,
    typer.Option(
        "--threads",
        metavar="COUNT",
        min=1,
        help="How many threads to use; by default as many as PyTorch chooses.",
        rich_help_panel=RUN,
    ),
]
JsonFile = Annotated[
    Path | None,
    typer.Option(
        "--json",
        metavar="FILE",
        help="Write the result as JSON, lengths in meters and times in seconds; - writes it to standard output, and "
        "nothing else.",
        rich_help_panel=OUTPUT,
    ),
]


def use(device: Device, threads: int | None) -> torch.device:
    """Set PyTorch's threads for this process, and return the device.

    Raises:
        ValueError: a GPU is asked for and PyTorch finds none.
    """
    there = device is Device.cpu or torch.cuda.is_available()
    expect_in_words(
        there, "--device", "cpu, or cuda where PyTorch finds a GPU", f"{device.value}, but PyTorch finds none"
    )
    if threads is not None:
        torch.set_num_threads(threads)
    return torch.device(device.value)
