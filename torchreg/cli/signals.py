"""Signals that end a command, as exceptions: what it holds is given back before it ends."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_ENDING = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


class Terminated(KeyboardInterrupt):
    """A signal other than an interrupt that ends the process; everything that cleans up after an interrupt does here.

    Attributes:
        code: the exit code of a process that a signal ended, as shells give it.
    """

    def __init__(self, number: int) -> None:
        super().__init__(f"ended by {signal.Signals(number).name}")
        self.code = 128 + number


@contextmanager
def terminable() -> Iterator[None]:
    """Raise ``Terminated`` where such a signal comes in this block.

    By default the process would end where it stands: its workers would go on until they notice, and what the system
    shares between processes (semaphores, memory) would stay for others to clean up. A signal that is ignored, as after
    ``nohup``, stays ignored. Only the main thread can do this; in others nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in _ENDING}
    for number, handler in before.items():
        if handler == signal.SIG_DFL:
            signal.signal(number, _terminate)
    try:
        yield
    finally:
        for number, handler in before.items():
            if handler == signal.SIG_DFL:
                signal.signal(number, handler)


def _terminate(number: int, frame: FrameType | None) -> None:
    raise Terminated(number)
