"""How far a batch is, for whoever watches."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple


class Progress(NamedTuple):
    """How far a stage is.

    Attributes:
        stage: ``"look"``, ``"describe"`` or ``"register"``.
        done: of its items, those done before this run included.
        total: items of the stage.
        failed: of those done, how many pairs are no success (of the last stage).
    """

    stage: str
    done: int
    total: int
    failed: int = 0


Report = Callable[[Progress], None]
