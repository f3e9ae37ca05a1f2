"""Clouds in trouble, and what every soft descriptor must be able to do with them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from problems import numbers, sphere_cloud
from torch import Tensor
from torch.autograd import gradcheck, gradgradcheck

import torchreg as tr

FEW = 5


def small(seed: int = 0) -> tr.Clouds:
    """Five points of a sphere, with normals and colors, in float64."""
    whole = sphere_cloud(60, seed=seed)
    return whole.rows(torch.arange(FEW), torch.tensor([0, FEW]))


def changed(
    cloud: tr.Clouds, points: Tensor | None = None, normals: Tensor | None = None, colors: Tensor | None = None
) -> tr.Clouds:
    return tr.Clouds(
        points=cloud.points if points is None else points,
        normals=cloud.normals if normals is None else normals,
        colors=cloud.colors if colors is None else colors,
        offsets=cloud.offsets,
    )


def _twins() -> tr.Clouds:
    cloud = small()
    return changed(cloud, points=cloud.points[torch.tensor([0, 0, 1, 1, 2])])


def _one_place() -> tr.Clouds:
    return changed(small(), points=torch.ones(FEW, 3, dtype=torch.float64))


def _parallel() -> tr.Clouds:
    return changed(small(), normals=torch.tensor([0.0, 0.6, 0.8], dtype=torch.float64).expand(FEW, 3).clone())


def _opposite() -> tr.Clouds:
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    return changed(small(), normals=torch.stack([up, -up, up, -up, up]))


def _column() -> tr.Clouds:
    """Every line between two points is parallel to every normal."""
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    return changed(
        small(), points=torch.arange(FEW, dtype=torch.float64)[:, None] * up, normals=up.expand(FEW, 3).clone()
    )


def _no_normals() -> tr.Clouds:
    return changed(small(), normals=torch.zeros(FEW, 3, dtype=torch.float64))


def _gray() -> tr.Clouds:
    return changed(small(), colors=torch.full((FEW, 3), 0.5, dtype=torch.float64))


def _black() -> tr.Clouds:
    return changed(small(), colors=torch.zeros(FEW, 3, dtype=torch.float64))


def _primaries() -> tr.Clouds:
    return changed(small(), colors=torch.cat([torch.eye(3), torch.eye(3)[:2]]).double())


TROUBLE: dict[str, Callable[[], tr.Clouds]] = {
    "twins": _twins,
    "one place": _one_place,
    "parallel normals": _parallel,
    "opposite normals": _opposite,
    "normals along all lines": _column,
    "normals of length zero": _no_normals,
    "gray": _gray,
    "black": _black,
    "equal and opposite hues": _primaries,
}


def leaves(cloud: tr.Clouds, near: tr.Neighborhoods) -> tuple[Tensor, ...]:
    """Points, normals, colors and neighbor weights that ask for gradients."""
    weights = numbers(*near.index.shape, seed=9).abs() + 0.5
    values = (cloud.points, cloud.normals, cloud.colors, weights)
    return tuple(value.detach().clone().requires_grad_() for value in values if value is not None)


def finite_gradients(function: Callable[..., Tensor], inputs: tuple[Tensor, ...], *, second: bool = True) -> bool:
    """Whether first and second derivatives of a random sum of the outputs are finite."""
    out = function(*inputs)
    first = _gradients((out * numbers(*out.shape, seed=5).to(out)).sum(), inputs)
    if not (bool(torch.isfinite(out).all()) and all(bool(torch.isfinite(part).all()) for part in first)):
        return False
    if not second:
        return True
    again = _gradients(sum((part**2).sum() for part in first), inputs)
    return all(bool(torch.isfinite(part).all()) for part in again)


def _gradients(value: Any, inputs: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    if not value.requires_grad:
        return tuple(torch.zeros_like(one) for one in inputs)
    return torch.autograd.grad(value, inputs, create_graph=True, allow_unused=True, materialize_grads=True)


def assert_derivatives(function: Callable[..., Tensor], inputs: tuple[Tensor, ...]) -> None:
    """First and second derivatives against differences."""
    assert gradcheck(function, inputs, atol=1e-5, rtol=1e-4)
    assert gradgradcheck(function, inputs, atol=1e-4, rtol=1e-3)
