"""The library of compiled kernels: found, checked, turned off and on, and called.

The kernels compute what functions in torch compute, with the same bits, in one pass over the memory where those make a
dozen, and without torch's overhead of some microseconds an operation. They are built when the package is installed
where a C++ compiler is at hand; elsewhere, and on other devices than the CPU, the functions in torch do the work.
"""

from __future__ import annotations

import ctypes
import functools
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchreg.arguments import checked
from torchreg.native.fingerprint import fingerprint
from torchreg.native.threads import kernel_threads

VARIABLE = "TORCHREG_NATIVE"
"""Environment variable; ``0`` turns compiled kernels off for a whole process, and for those that it starts."""

KERNEL_TYPES = {torch.float32: "f32", torch.float64: "f64"}
"""The ends of the names of kernels that take either, by the type of the numbers."""

_FOLDER = Path(__file__).parent
_BY_CAPABILITY = {"AVX512": ("avx512", "avx2", "default"), "AVX2": ("avx2", "default")}
_KERNEL = ctypes.CFUNCTYPE(ctypes.c_int64)
_REFUSALS = {
    -(2**63): (MemoryError, "not enough memory to work in"),
    1 - 2**63: (IndexError, "an index beyond what it points into"),
}
"""What kernels return where they gave up, as ``Refusal`` in ``src/common.hpp``."""

_wanted: ContextVar[bool] = ContextVar("native_kernels", default=os.environ.get(VARIABLE, "1") != "0")


@checked
@contextmanager
def native_kernels(enabled: bool = True) -> Iterator[None]:
    """Within this context kernels run compiled, where a library is at hand, or with ``False`` by torch; same bits.

    Example:
        >>> with native_kernels(False):
        ...     pass
    """
    token = _wanted.set(enabled)
    try:
        yield
    finally:
        _wanted.reset(token)


def native_library() -> str:
    """The file of the library in use, or an empty text where there is none.

    Example:
        >>> import torchreg as tr
        >>> isinstance(tr.native_library(), str)
        True
    """
    found = _library()
    return "" if found is None else Path(found._name).name


def native(*tensors: Tensor | None) -> bool:
    """Whether a compiled kernel may work on these tensors: plain ones on the CPU, outside of traces and transforms.

    Kernels see numbers alone. Where something follows the operations of torch, a trace, a dispatch mode, a tangent of
    forward-mode differentiation, the functions in torch work.
    """
    if not _wanted.get() or _followed() or _library() is None:
        return False
    return all(tensor is None or _plain(tensor) for tensor in tensors)


def call(name: str, *arguments: Tensor | int | float | None) -> int:
    """Run a kernel: contiguous tensors by their memory, numbers as int64 or double, and last the number of threads.

    What a kernel expects stands beside it in its source; nothing is checked here but that tensors are contiguous and on
    the CPU.

    Raises:
        MemoryError: there is not enough for the kernel to work in.
        IndexError: an index beyond what it points into.
    """
    library = _library()
    if library is None:
        raise RuntimeError("no library of compiled kernels; ask native() first")
    result: int = _function(library, name)(*map(_argument, arguments), ctypes.c_int64(kernel_threads()))
    if result < 0:
        error, text = _REFUSALS.get(result, (RuntimeError, "it failed"))
        raise error(f"kernel {name}: {text}")
    return result


@functools.cache
def _library() -> ctypes.CDLL | None:
    """The widest library for this processor that can be loaded and fits the sources beside it."""
    sources = fingerprint(_FOLDER / "src")
    for level in _BY_CAPABILITY.get(torch.backends.cpu.get_cpu_capability(), ("default",)):
        for path in sorted((_FOLDER / "lib").glob(f"kernels_{level}.*")):
            library = _checked(path, sources)
            if library is not None:
                return library
    return None


def _checked(path: Path, sources: str) -> ctypes.CDLL | None:
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        warnings.warn(f"compiled kernels are not used: {error}", RuntimeWarning, stacklevel=2)
        return None
    library.torchreg_sources.restype = ctypes.c_char_p
    built = library.torchreg_sources().decode()
    if sources not in ("", built):
        text = "compiled kernels are not used: they are older than their sources; install the package again"
        warnings.warn(text, RuntimeWarning, stacklevel=2)
        return None
    return library


@functools.cache
def _function(library: ctypes.CDLL, name: str) -> Any:  # noqa: ANN401
    return ctypes.cast(ctypes.c_void_p.in_dll(library, name), _KERNEL)


def _argument(value: Tensor | int | float | None) -> Any:  # noqa: ANN401
    if isinstance(value, Tensor):
        if not value.is_cpu or not value.is_contiguous():
            raise RuntimeError(
                f"a kernel takes contiguous tensors on the CPU, got one on {value.device}, strides {value.stride()}"
            )
        return ctypes.c_void_p(value.data_ptr())
    if value is None:
        return ctypes.c_void_p(None)
    return ctypes.c_double(value) if isinstance(value, float) else ctypes.c_int64(value)


def _plain(tensor: Tensor) -> bool:
    return (
        type(tensor) in (Tensor, torch.nn.Parameter)
        and tensor.is_cpu
        and tensor.layout is torch.strided
        and not tensor.is_neg()
        and not torch._C._functorch.is_functorch_wrapped_tensor(tensor)
    )


def _followed() -> bool:
    return (
        torch.compiler.is_compiling()
        or torch._C._get_tracing_state() is not None
        or torch._C._len_torch_dispatch_stack() > 0
        or torch.autograd.forward_ad._current_level >= 0
    )
