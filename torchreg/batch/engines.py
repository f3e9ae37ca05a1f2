"""What runs the work of a batch: this machine's processes, or Ray's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Protocol

from torchreg.batch.jobs import Job
from torchreg.batch.outcome import Outcome


class Engine(Protocol):
    """Runs a job over items, in any order, a bounded number of them at a time."""

    @property
    def device(self) -> str:
        """Where it computes."""

    @property
    def workers(self) -> int:
        """How many items are worked on at once."""

    def run(self, job: Job, items: Sequence[Any]) -> Iterator[tuple[int, Outcome]]:
        """Yield the place of every item and what came of it, as soon as it is there, each once.

        A process that dies fails at most the item that it was at, and that only after it was tried again.
        """

    def close(self) -> None:
        """Give back what the engine holds."""
