"""What comes of one piece of work: its value, or why there is none."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable
from typing import Any, NamedTuple

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG)


class Outcome(NamedTuple):
    """Of one item.

    Attributes:
        value: what was made; ``None`` beside a reason.
        reason: why there is none, else empty.
        expected: whether the reason is one that input can give, such as a damaged file; a defect otherwise.
        no_room: whether nothing can be written any more, so that going on would lose all that follows.
        seconds: that the work took.
    """

    value: Any
    reason: str = ""
    expected: bool = True
    no_room: bool = False
    seconds: float = 0.0


def stop_without_room(outcome: Outcome) -> None:
    """End the run where nothing can be written any more.

    Raises:
        OSError: there is no room.
    """
    if outcome.no_room:
        raise OSError(f"{outcome.reason} (what is finished stands; the same command goes on from there)")


def attempt(work: Callable[..., Any], *arguments: Any) -> Outcome:  # noqa: ANN401
    """Do a piece of work; an error becomes a reason, so that it ends no other piece."""
    begin = time.perf_counter()
    try:
        return Outcome(work(*arguments), seconds=time.perf_counter() - begin)
    except OSError as error:
        text = f"{error.strerror or error}{f': {error.filename}' if error.filename else ''}"
        return Outcome(None, text, no_room=error.errno in _NO_ROOM)
    except ValueError as error:
        return Outcome(None, str(error) or type(error).__name__)
    except MemoryError:
        return Outcome(None, "out of memory", expected=False)
    except Exception as error:
        return Outcome(None, f"unexpected {type(error).__name__}: {error}", expected=False)
