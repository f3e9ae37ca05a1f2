"""The settings of the paper's experiments (section 4.1, its Tables 1 to 4), as data.

The paper gives roll, pitch and yaw without the order in which they turn. Here R = Rz(yaw) Ry(pitch) Rx(roll); another
order gives another initial pose, which matters to no method that needs no first guess.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import rigid


class InitialPose(NamedTuple):
    """How the target is moved before the registration: the truth."""

    roll: float  # degrees, about x
    pitch: float  # degrees, about y
    yaw: float  # degrees, about z
    x: float  # meters
    y: float  # meters
    z: float  # meters

    def matrix(self) -> Tensor:
        """``T_moved_target`` (4, 4) float64: turned, then shifted."""
        R = _turn(2, self.yaw) @ _turn(1, self.pitch) @ _turn(0, self.roll)
        return rigid(R, torch.tensor([self.x, self.y, self.z], dtype=torch.float64))


class PaperSetting(NamedTuple):
    """One column of the paper's tables."""

    experiment: int  # 1, 2, 3 or 5
    name: str
    points: tuple[int, int]  # of the source and of the target, drawn at random
    pose: InitialPose
    outdoor: bool = False  # the road rather than the mall


SETTINGS = (
    PaperSetting(1, "1", (10_000, 10_000), InitialPose(55.08, -9.61, -55.52, -20.097, 20.474, 24.060)),
    PaperSetting(1, "2", (10_000, 10_000), InitialPose(60.63, -84.00, 97.76, 8.376, -7.014, 8.380)),
    PaperSetting(1, "3", (10_000, 10_000), InitialPose(33.68, 41.03, 17.52, -3.523, -0.243, 1.931)),
    PaperSetting(2, "12k / 4k", (12_000, 4_000), InitialPose(-2.38, -68.74, 30.71, 3.362, 3.933, -3.000)),
    PaperSetting(3, "4k", (4_000, 4_000), InitialPose(55.97, 14.39, -34.77, 4.479, 2.380, 1.579)),
    PaperSetting(3, "2k", (2_000, 2_000), InitialPose(-39.97, 35.47, -18.12, 0.666, 0.087, -2.754)),
    PaperSetting(3, "1k", (1_000, 1_000), InitialPose(-11.23, -58.75, -22.35, 4.966, 4.855, -4.406)),
    PaperSetting(3, "0.5k", (500, 500), InitialPose(-28.28, -61.12, -19.60, -3.183, 4.865, 1.291)),
    PaperSetting(5, "road", (10_000, 10_000), InitialPose(52.47, 23.51, -56.22, -97.50, 81.86, 81.90), outdoor=True),
)
"""Tables 1 to 4. Experiment 4 measures times with the point counts of Experiment 3."""

EXPERIMENTS = (1, 2, 3, 4, 5)

TABLES = {1: 5, 2: 6, 3: 7, 4: 8, 5: 9}
"""The paper's table with the results of each experiment."""


RUNS = 3
"""Of RANSAC on every pair, with draws of their own."""


class RunSize(NamedTuple):
    """How long a run takes: at the paper's sizes, or at small ones to see that everything works."""

    angular_step: float  # degrees between the rays of the simulated scanners
    divisor: int  # of the paper's point counts
    hypotheses: int  # that RANSAC draws at most
    repeats: int  # of every measured time
    beyond: int  # places that are also scanned from stations apart, and registered in all ways, at most


FULL = RunSize(angular_step=0.4, divisor=1, hypotheses=600_000, repeats=7, beyond=10)
QUICK = RunSize(angular_step=1.5, divisor=4, hypotheses=50_000, repeats=2, beyond=0)


def settings_of(experiment: int) -> tuple[PaperSetting, ...]:
    """The settings of one experiment, in the order of the paper's columns; none for Experiment 4."""
    return tuple(setting for setting in SETTINGS if setting.experiment == experiment)


def _turn(axis: int, degrees: float) -> Tensor:
    """A rotation (3, 3) about a coordinate axis."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    R = torch.eye(3, dtype=torch.float64)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R[i, i], R[j, j], R[i, j], R[j, i] = c, c, -s, s
    return R
