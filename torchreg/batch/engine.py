"""What an engine of a batch does, the outcome of each piece of work, and the progress of a batch."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, Protocol

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG)


class CannotKeepError(OSError):
    """What a piece of work made cannot be written, which is the fault of no input: all that follows would be lost."""


class Job(NamedTuple):
    """One kind of work on items that can be pickled.

    Attributes:
        load: from an item to what computing needs, on the CPU.
        compute: from the item, what was loaded and the device to the value.
    """

    load: Callable[[Any], Any]
    compute: Callable[[Any, Any, str], Any]


class Outcome(NamedTuple):
    """The result of the work on one item, or why there is none.

    Attributes:
        value: the result; ``None`` beside a reason.
        reason: why there is none, else empty.
        expected: whether the reason is one that input can give, such as a damaged file; a defect otherwise.
        no_room: whether nothing can be written any more, so that all that follows would be lost.
        seconds: that the work took.
    """

    value: Any
    reason: str = ""
    expected: bool = True
    no_room: bool = False
    seconds: float = 0.0


class Engine(Protocol):
    """Runs a job over items, in any order, a bounded number of them at a time.

    Attributes:
        device: where it computes.

    Example:
        >>> from torchreg.batch import Engine, LocalEngine
        >>> engine: Engine = LocalEngine(workers=0)
        >>> engine.close()
    """

    device: str

    @property
    def workers(self) -> int:
        """How many items are worked on at once."""

    def run(self, job: Job, items: Sequence[Any]) -> Iterator[tuple[int, Outcome]]:
        """Yield the index and the outcome of every item once, as soon as it is there.

        A process that dies fails at most the item that it worked on, and that only after it was tried again.
        """

    def close(self) -> None:
        """Give back what the engine holds."""


class BatchProgress(NamedTuple):
    """How far a stage of a batch is.

    Attributes:
        stage: ``"measure"``, ``"describe"`` or ``"register"``.
        done: of its items, those done before this run included.
        total: items of the stage.
        failed: of those done, how many pairs are no success (of the last stage).

    Example:
        >>> from torchreg.batch import BatchProgress
        >>> BatchProgress("register", done=3, total=10).failed
        0
    """

    stage: str
    done: int
    total: int
    failed: int = 0


Report = Callable[[BatchProgress], None]


def load_and_compute(job: Job, device: str, item: Any) -> Outcome:  # noqa: ANN401
    """Both halves of a job in one process."""
    return attempt(lambda: job.compute(item, job.load(item), device))


def attempt(work: Callable[..., Any], *arguments: Any) -> Outcome:  # noqa: ANN401
    """Do a piece of work; an error becomes a reason, so that it ends no other piece."""
    begin = time.perf_counter()
    try:
        return Outcome(work(*arguments), seconds=time.perf_counter() - begin)
    except OSError as error:
        text = f"{error.strerror or error}{f': {error.filename}' if error.filename else ''}"
        return Outcome(None, text, no_room=isinstance(error, CannotKeepError) or error.errno in _NO_ROOM)
    except ValueError as error:
        return Outcome(None, str(error) or type(error).__name__)
    except MemoryError:
        return Outcome(None, "out of memory", expected=False)
    except Exception as error:
        return Outcome(None, f"unexpected {type(error).__name__}: {error}", expected=False)


def stop_without_room(outcome: Outcome) -> None:
    """End the run where nothing can be written any more.

    Raises:
        OSError: there is no room.
    """
    if outcome.no_room:
        raise OSError(f"{outcome.reason} (finished pairs are kept; the same command resumes from there)")
