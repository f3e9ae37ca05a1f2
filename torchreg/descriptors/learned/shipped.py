"""The weights that come with the library, as JSON that a person can read."""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchreg.descriptors.learned.model import LearnedColor
from torchreg.types import Clouds, Features, Neighborhoods

SHIPPED = Path(__file__).with_name("weights.json")


def save_weights(model: LearnedColor, path: Path) -> Path:
    """Write a model's sizes and parameters."""
    content = {
        "bins": model.bins,
        "channels": list(model.channels),
        "hidden": model.hidden,
        "parameters": {name: value.detach().double().tolist() for name, value in model.state_dict().items()},
    }
    path.write_text(json.dumps(content, indent=1) + "\n")
    return path


def load_weights(path: Path = SHIPPED) -> LearnedColor:
    """A model as ``save_weights`` wrote it; without a path, the one that comes with the library.

    Raises:
        FileNotFoundError: no such file.
        RuntimeError: parameters that do not fit the sizes.
    """
    content: dict[str, Any] = json.loads(path.read_text())
    with torch.random.fork_rng(devices=[]):  # the drawn weights are overwritten at once
        model = LearnedColor(bins=content["bins"], channels=tuple(content["channels"]), hidden=content["hidden"])
    model.load_state_dict({name: torch.tensor(value) for name, value in content["parameters"].items()})
    return model.requires_grad_(False)


def shipped_color(cloud: Clouds, near: Neighborhoods, radius: float | Tensor) -> Features:
    """The color block of the shipped weights; arguments as for ``LearnedColor``. No gradients."""
    with torch.no_grad():
        found: Features = _shipped(str(cloud.device))(cloud, near.trimmed(), radius)
    return found


def shipped_numbers() -> tuple[float, float]:
    """The shipped block's weight beside FPFH's 1, and the root of FPFH's entries."""
    parameters = json.loads(SHIPPED.read_text())["parameters"]
    return math.exp(parameters["log_block"]), 1 / (1 + math.exp(-parameters["root_logits"][0]))


@cache
def _shipped(device: str) -> LearnedColor:
    return load_weights().to(device)
