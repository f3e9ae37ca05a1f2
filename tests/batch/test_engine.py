"""Errors of one piece of work, told apart."""

import errno

import pytest

from torchreg.batch.engine import attempt
from torchreg.errors import CloudFileError


def raising(error):
    def work():
        raise error

    return work


@pytest.mark.parametrize(
    ("error", "reason", "expected", "no_room"),
    [
        (CloudFileError("a.ply: expected a file, got nothing"), "a.ply: expected a file, got nothing", True, False),
        (ValueError("points: expected more"), "points: expected more", True, False),
        (FileNotFoundError(errno.ENOENT, "No such file", "b.ply"), "No such file: b.ply", True, False),
        (OSError(errno.ENOSPC, "No space left on device", "c.pt"), "No space left on device: c.pt", True, True),
        (OSError(errno.EROFS, "Read-only file system"), "Read-only file system", True, True),
        (MemoryError(), "out of memory", False, False),
        (ZeroDivisionError("division by zero"), "unexpected ZeroDivisionError: division by zero", False, False),
    ],
)
def test_an_error_becomes_a_reason(error, reason, expected, no_room):
    outcome = attempt(raising(error))
    assert (outcome.value, outcome.reason, outcome.expected, outcome.no_room) == (None, reason, expected, no_room)


def test_a_value_comes_with_its_time():
    outcome = attempt(lambda a, b: a + b, 2, 3)
    assert (outcome.value, outcome.reason) == (5, "")
    assert outcome.seconds >= 0


def test_an_interrupt_is_no_outcome():
    with pytest.raises(KeyboardInterrupt):
        attempt(raising(KeyboardInterrupt()))
