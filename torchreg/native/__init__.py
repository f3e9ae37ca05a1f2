"""Compiled kernels for the CPU, beside the functions in torch that say what they compute."""

from torchreg.native.library import KERNEL_TYPES, call, native, native_kernels, native_library
from torchreg.native.strided import rows
from torchreg.native.threads import kernel_threads, torch_on_one_thread

__all__ = [
    "KERNEL_TYPES",
    "call",
    "kernel_threads",
    "native",
    "native_kernels",
    "native_library",
    "rows",
    "torch_on_one_thread",
]
