"""Compiled kernels for the CPU, beside the functions in torch that say what they compute."""

from torchreg.native.library import call, native, native_kernels, native_library
<<<<<<< HEAD
from torchreg.native.rows import rows
from torchreg.native.threads import kernel_threads, torch_on_one_thread
=======
from torchreg.native.strided import rows
>>>>>>> desc

__all__ = ["call", "kernel_threads", "native", "native_kernels", "native_library", "rows", "torch_on_one_thread"]
