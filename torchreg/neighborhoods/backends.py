"""Which code searches: Open3D on the CPU, torch alone anywhere."""

from __future__ import annotations

import torch

from torchreg.errors import expect, one_of

BACKENDS = ("auto", "open3d", "torch")


def uses_open3d(backend: str, device: torch.device) -> bool:
    """Resolve ``backend`` for points on ``device``; ``"auto"`` takes Open3D where it can.

    Raises:
        ValueError: an unknown name, or Open3D for points that are not on the CPU.
    """
    one_of(backend, "backend", BACKENDS)
    on_cpu = device.type == "cpu"
    expect(on_cpu or backend != "open3d", "backend", f"'auto' or 'torch' for points on {device}", backend)
    return on_cpu and backend != "torch"
