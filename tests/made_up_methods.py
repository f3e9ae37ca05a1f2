"""Methods that answer what a test tells them, in place of real ones."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from torchreg.benchmark.peers import Answer, Method, PeerMatches, Task
from torchreg.types import Correspondences


def answering(name: str, answer: Callable[[Task], Answer], **more: object) -> Method:
    return Method(name=name, title=f"the {name}", statement=f"Made up: {name}.", run=answer, **more)


def posing(name: str, pose: Callable[[Task], Tensor], success: bool = True) -> Method:
    """Answers with a pose, and matches every point of the source with the target's point of the same row."""

    def answer(task: Task) -> Answer:
        rows = torch.arange(min(len(task.source.points), len(task.target.points)))
        matches = Correspondences(rows, rows, torch.tensor([0, len(rows)]), torch.zeros(len(rows)))
        return Answer(
            T_target_source=pose(task), success=success, matches=PeerMatches(task.source, task.target, matches)
        )

    return answering(name, answer)


def raising(name: str) -> Method:
    def answer(task: Task) -> Answer:
        raise RuntimeError("out of luck")

    return answering(name, answer)


def absent(name: str) -> Method:
    return answering(name, _never, module="no_such_module_anywhere", package="no-such-package")


def _never(task: Task) -> Answer:
    raise AssertionError("a method that is not installed was run")


def install(monkeypatch: object, *methods: Method) -> None:
    """Make these all the methods there are."""
    from torchreg.benchmark.peers import registry

    monkeypatch.setattr(registry, "METHODS", {method.name: method for method in methods})
