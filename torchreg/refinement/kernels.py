"""Robust weights of residuals, as Open3D's ``RobustKernel`` defines them.

A weight w(r) turns sum_i w(r_i) r_i^2 at fixed weights into one step on the robust loss (iteratively reweighted
least squares: Babin, Giguere and Pomerleau, ICRA 2019, doi:10.1109/ICRA.2019.8794020).
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

Kernel = Callable[[Tensor, Tensor], Tensor]
"""Weights of residuals (any shape), given scales that broadcast against them."""


def least_squares(residual: Tensor, scale: Tensor) -> Tensor:
    """1: every residual counts as it is."""
    del scale
    return torch.ones_like(residual)


def huber(residual: Tensor, scale: Tensor) -> Tensor:
    """1 up to ``scale``, scale / |r| beyond."""
    far = residual.abs()
    return torch.where(far > scale, scale / torch.maximum(far, scale), torch.ones_like(far))


def tukey(residual: Tensor, scale: Tensor) -> Tensor:
    """(1 - (r / scale)^2)^2 up to ``scale``, nothing beyond."""
    share = residual / scale
    rest = (1 - share * share).clamp_min(0)
    return rest * rest


def geman_mcclure(residual: Tensor, scale: Tensor) -> Tensor:
    """scale / (scale + r^2)^2, where ``scale`` is in squared units of ``r``."""
    spread = scale + residual * residual
    return scale / (spread * spread)


KERNELS: dict[str, Kernel] = {"huber": huber, "tukey": tukey, "geman_mcclure": geman_mcclure}
