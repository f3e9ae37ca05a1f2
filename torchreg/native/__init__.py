"""Compiled kernels for the CPU, beside the functions in torch that say what they compute."""

from torchreg.native.library import call, native, native_kernels, native_library
from torchreg.native.strided import rows

__all__ = ["call", "native", "native_kernels", "native_library", "rows"]
