"""The folder of a training run: a checkpoint to resume from, the weights, the log, and what held-out pairs show.

checkpoint.pt   all that a resumed run depends on      weights.pt      the network, for torchreg.learning.load_network
log.csv         step, loss, rate, inlier ratio         held_out.csv    every held-out pair by all features
held_out.json   means by group                         tensorboard/    the log again, where TensorBoard is installed
"""

from __future__ import annotations

import csv
import io
import json
import pickle
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import torch

from torchreg.errors import expect_in_words
from torchreg.io.atomic import atomic_write, write_text
from torchreg.learning.held_out import MatchQuality, by_group
from torchreg.learning.network_training import NetworkTraining, saved_network


@dataclass(frozen=True)
class LogRow:
    """One line of the log.

    Attributes:
        step: how many are done.
        loss: the mean since the line before.
        rate: the step size of the next step.
        inlier_ratio: of the network's features over one held-out pair of every group; NaN where none is held out.
    """

    step: int
    loss: float
    rate: float
    inlier_ratio: float


@dataclass
class TrainingFolder:
    """What a run has written, and where.

    Attributes:
        path: of the folder, made if need be.
        run: what the run is, as plain values; another run is not resumed.
        log: its lines so far.
    """

    path: Path
    run: dict[str, Any]
    log: list[LogRow] = field(default_factory=list)

    def checkpoint(self) -> dict[str, Any] | None:
        """The state of the training that the folder holds, or ``None``; its log is taken up.

        Raises:
            ValueError: the folder holds another run, or a checkpoint that cannot be read.
        """
        self.path.mkdir(exist_ok=True)
        file = self.path / "checkpoint.pt"
        if not file.exists():
            return None
        try:
            state = torch.load(file, map_location="cpu", weights_only=True)
            run, log = state["run"], [LogRow(**row) for row in state["log"]]
            training: dict[str, Any] = state["training"]
        except (pickle.UnpicklingError, RuntimeError, EOFError, KeyError, TypeError) as error:
            raise ValueError(f"{file}: expected a checkpoint of torchreg train, got {error}") from None
        unlike = sorted(name for name in self.run.keys() | run.keys() if self.run.get(name) != run.get(name))
        expected = ", ".join(f"{name} {self.run.get(name)}" for name in unlike)
        received = ", ".join(f"{name} {run.get(name)}" for name in unlike)
        expect_in_words(
            not unlike, "--out", f"an empty folder, or one of a run with {expected}", f"{self.path} with {received}"
        )
        self.log = log
        return training

    def keep(self, training: NetworkTraining, row: LogRow) -> None:
        """Write checkpoint, weights and log; each file in full or not at all, the checkpoint last."""
        self.log.append(row)
        self._save("weights.pt", saved_network(training))
        write_text(self.path / "log.csv", _table([asdict(row) for row in self.log]), through_link=False)
        log = [asdict(row) for row in self.log]
        self._save("checkpoint.pt", {"training": training.state_dict(), "run": self.run, "log": log})

    def keep_held_out(self, qualities: Sequence[MatchQuality]) -> None:
        """Write what every held-out pair shows, and the means by group."""
        if qualities:
            write_text(self.path / "held_out.csv", _table([asdict(one) for one in qualities]), through_link=False)
        means = {"run": self.run, "groups": [row._asdict() for row in by_group(qualities)]}
        write_text(self.path / "held_out.json", json.dumps(means, indent=2) + "\n", through_link=False)

    def _save(self, name: str, state: dict[str, Any]) -> None:
        with atomic_write(self.path / name, through_link=False) as file:
            torch.save(state, file)


class Board:
    """The log as TensorBoard shows it; without TensorBoard nothing is written."""

    def __init__(self, folder: Path) -> None:
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            self._writer: Any = None
        else:
            self._writer = SummaryWriter(str(folder / "tensorboard"))

    def show(self, row: LogRow) -> None:
        """Add one line of the log."""
        if self._writer is None:
            return
        for part in fields(row)[1:]:
            self._writer.add_scalar(part.name, getattr(row, part.name), row.step)
        self._writer.flush()


def _table(rows: Sequence[dict[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
