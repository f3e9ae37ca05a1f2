"""Kernels fused into one pass by ``torch.compile``, where that is turned on.

The elementwise kernels of this package read their inputs from the cache some hundred times, once per operation. Fused
they read them once, which is several times faster; compiling takes seconds once for every kernel and machine (a disk
cache keeps the result), and needs a C++ compiler on the CPU.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

import torch

from torchreg.arguments import checked

VARIABLE = "TORCHREG_COMPILE"
"""Environment variable that turns compiled kernels on for a whole process, and for those that it starts."""

_wanted: ContextVar[bool] = ContextVar("compiled_kernels", default=os.environ.get(VARIABLE, "0") not in ("", "0"))

_compiled: list[Any] = []  # one cached compiler per kernel

_Kernel = TypeVar("_Kernel", bound=Callable[..., Any])


@checked
@contextmanager
def compiled_kernels(enabled: bool = True) -> Iterator[None]:
    """Within this context descriptor kernels run compiled.

    Args:
        enabled: ``False`` turns them off, such as where ``TORCHREG_COMPILE=1`` turned them on.

    Hard histograms are the same bits with and without; soft ones differ by rounding. The first call of a kernel takes
    some seconds. Where no compiler is found, that call raises the error of ``torch.compile``.

    Example:
        >>> with compiled_kernels(False):
        ...     pass
    """
    token = _wanted.set(enabled)
    try:
        yield
    finally:
        _wanted.reset(token)


def kernels_are_compiled() -> bool:
    """Whether kernels run compiled here."""
    return _wanted.get()


def forget_compiled() -> None:
    """Compile every kernel again when it is called next."""
    for compiled in _compiled:
        compiled.cache_clear()


def fusible(kernel: _Kernel) -> _Kernel:
    """Mark a function of tensors, all of it elementwise operations and sums over rows, as one to compile on demand."""

    @functools.cache
    def compiled() -> Callable[..., Any]:
        return torch.compile(kernel, fullgraph=True, dynamic=True)

    _compiled.append(compiled)

    @functools.wraps(kernel)
    def call(*args: Any, **words: Any) -> Any:  # noqa: ANN401
        if not torch.compiler.is_compiling() and kernels_are_compiled():
            return compiled()(*args, **words)
        return kernel(*args, **words)

    return call  # type: ignore[return-value]
