"""Where, and on how many threads, a command computes."""

from __future__ import annotations

import torch

from torchreg.cli.options import Device
from torchreg.errors import expect


def use(device: Device, threads: int | None) -> torch.device:
    """Set PyTorch's threads for this process, and return the device.

    Raises:
        ValueError: a GPU is asked for and PyTorch finds none.
    """
    there = device is Device.cpu or torch.cuda.is_available()
    expect(there, "--device", "cpu, or cuda where PyTorch finds a GPU", f"{device.value}, and it finds none")
    if threads is not None:
        torch.set_num_threads(threads)
    return torch.device(device.value)
