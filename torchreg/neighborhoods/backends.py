"""Which search answers: compiled kernels, Open3D's tree, or torch alone."""

from __future__ import annotations

from torch import Tensor

from torchreg.errors import expect, one_of
from torchreg.neighborhoods.kd_tree import fits_tree

BACKENDS = ("auto", "native", "open3d", "torch")


def backend_for(backend: str, points: Tensor) -> str:
    """``"native"``, ``"open3d"`` or ``"torch"``: ``backend``, where ``"auto"`` takes the first that can search points.

    Raises:
        ValueError: an unknown name, or one that cannot search these points.
    """
    one_of(backend, "backend", BACKENDS)
    on_cpu, compiled = points.device.type == "cpu", fits_tree(points)
    expect(on_cpu or backend != "open3d", "backend", f"'auto' or 'torch' for points on {points.device}", backend)
    usable = compiled or backend != "native" or len(points) == 0
    expect(usable, "backend", f"'auto', as no compiled kernels are at hand for points on {points.device}", backend)
    if backend != "auto":
        return backend
    return "native" if compiled else "open3d" if on_cpu else "torch"
