"""The batch engine on Ray, for one machine or a cluster: the same work, as tasks of Ray's scheduler.

Ray starts a cluster of this machine by itself, or joins the one whose address is given. One that is started here
listens on the loopback alone, since whoever reaches a port of Ray can run code; any value of the variable
``RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER`` in the environment, which is Ray's own, is left to Ray. All machines of a cluster
must see the clouds and the batch's folder under the same paths. A task whose process dies is tried again; no more tasks
are handed over than the workers can soon take, so that thousands of pairs never sit in memory.
"""

from __future__ import annotations

import os
import signal
import socket
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from torchreg.arguments import checked
from torchreg.batch.engine import Job, Outcome, load_and_compute
from torchreg.errors import at_least, expect

_RETRIES = 3
_ANSWER_SECONDS = 5.0
_SEVERAL_MACHINES = "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"  # Ray's: whether its clusters may have several
_AHEAD = 2  # tasks in the scheduler's hands, for every worker


class RayEngine:
    """Ray's workers. To be closed when the batch is done.

    Args:
        workers: of a cluster that is started here; ``None`` as many as there are cores. Not for one that is joined.
        address: of a cluster to join, such as ``"auto"`` or ``"ray://host:10001"``; ``None`` starts one.
        device: where to compute.

    Raises:
        ValueError: Ray is not installed, or no cluster answers at the address.

    Example:
        >>> from torchreg.batch import RayEngine
        >>> engine = RayEngine(workers=4)  # doctest: +SKIP
        >>> engine.close()  # doctest: +SKIP
    """

    @checked
    def __init__(self, workers: int | None = None, address: str | None = None, device: str = "cpu") -> None:
        if workers is not None:
            at_least(workers, "workers", 1)
            expect(address is None, "workers", "none beside the address of a cluster, which has its own", workers)
        try:
            import ray
        except ImportError:
            raise ValueError('engine: expected Ray, which pip install "torchreg-pointcloud[ray]" brings') from None
        if address is not None:
            _expect_answer(address)
        self._ray, self.device = ray, device
        self._started = not ray.is_initialized()
        if self._started:
            how: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
            try:
                with _same_handlers():
                    if address is not None:
                        ray.init(address=address, **how)
                    else:
                        with _on_loopback(ray):
                            ray.init(address="local", num_cpus=workers, include_dashboard=False, **how)
            except Exception as error:  # Ray raises many kinds, its plain one among them
                raise ValueError(f"address: expected a cluster that answers, got {address!r}: {error}") from None
        gpus = 0 if device == "cpu" else 1
        self._task = ray.remote(num_cpus=1, num_gpus=gpus, max_retries=_RETRIES)(load_and_compute)

    @property
    def workers(self) -> int:
        """How many items are worked on at once."""
        return max(1, int(self._ray.cluster_resources().get("CPU", 1)))

    def run(self, job: Job, items: Sequence[Any]) -> Iterator[tuple[int, Outcome]]:
        """As ``Engine``'s."""
        handed: dict[Any, int] = {}
        waiting = iter(range(len(items)))
        try:
            while True:
                while len(handed) < _AHEAD * self.workers:
                    place = next(waiting, None)
                    if place is None:
                        break
                    handed[self._task.remote(job, self.device, items[place])] = place
                if not handed:
                    return
                ready, _ = self._ray.wait(list(handed), num_returns=1)
                for task in ready:
                    yield handed.pop(task), self._value(task)
        finally:  # nothing runs on when the caller stops asking
            for task in handed:
                self._ray.cancel(task, force=True)

    def close(self) -> None:
        """Leave the cluster, and end it where it was started here."""
        if self._started:
            self._ray.shutdown()

    def _value(self, task: Any) -> Outcome:  # noqa: ANN401
        try:
            outcome: Outcome = self._ray.get(task)
        except self._ray.exceptions.RayError as error:
            first = str(error).strip().splitlines()[0]
            return Outcome(None, f"its Ray worker died {_RETRIES + 1} times: {first}", expected=False)
        return outcome


@contextmanager
def _on_loopback(ray: Any) -> Iterator[None]:  # noqa: ANN401
    """Make a cluster that starts in this block one of 127.0.0.1, as Ray does on systems whose firewalls ask.

    Ray takes its own address wherever it is given the loopback's, unless it knows clusters of one machine alone.
    """
    constants, before = ray._private.ray_constants, os.environ.get(_SEVERAL_MACHINES)
    if before is not None:
        yield
        return
    several, constants.ENABLE_RAY_CLUSTER = constants.ENABLE_RAY_CLUSTER, False
    os.environ[_SEVERAL_MACHINES] = "0"  # for the processes that it starts
    try:
        yield
    finally:
        constants.ENABLE_RAY_CLUSTER = several
        del os.environ[_SEVERAL_MACHINES]


@contextmanager
def _same_handlers() -> Iterator[None]:
    """Keep what this process does when it is terminated; Ray would exit by its own rule, with a stack of addresses."""
    main = threading.current_thread() is threading.main_thread()
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if main and before is not None:
            signal.signal(signal.SIGTERM, before)


def _expect_answer(address: str) -> None:
    """Refuse an address HOST:PORT at which nothing listens, within seconds; Ray itself asks for minutes."""
    host, mark, port = address.removeprefix("ray://").rpartition(":")
    if not mark or not port.isdigit():  # such as "auto", which Ray looks up
        return
    try:
        socket.create_connection((host, int(port)), timeout=_ANSWER_SECONDS).close()
    except (OSError, OverflowError) as error:
        raise ValueError(f"address: expected a cluster that answers, got {address!r}: {error}") from None
