"""Clouds described by a module that its user trained, in place of the library's descriptors.

Within ``register`` the clouds are thinned and get normals as ever, then the module is called, cloud by cloud, so that
its features, too, do not depend on the batch. Poses are judged as ``register_features`` judges them.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import torch
from torch import nn

from torchreg.errors import expect
from torchreg.neighborhoods.search import neighbors
from torchreg.registration.describe import describe_thin, description_of, judging_description
from torchreg.registration.described import DescribedClouds, Description
from torchreg.registration.matchings import DescriptorMatching, FeatureMatching, Matching
from torchreg.registration.outside import GivenFeatures, checked_features
from torchreg.registration.plan import Describe
from torchreg.types import Clouds, Features, Neighborhoods

Trained = Callable[..., GivenFeatures]
"""A module, or any function, of a cloud, and of its ``Neighborhoods`` where it needs a second argument."""


class Describing(NamedTuple):
    """How ``register`` describes clouds, and what it matches them by."""

    description: Callable[..., Description]  # of the options
    describe: Describe
    matching: Matching


BY_OPTIONS = Describing(description_of, describe_thin, DescriptorMatching())
"""By the descriptors of the options."""


def by_module(module: Trained) -> Describing:
    """By a module; what the options describe clouds by then judges poses alone.

    Raises:
        TypeError: it cannot be called.
    """
    if not callable(module):
        raise TypeError(f"describe: expected a module that takes a cloud, got {type(module).__name__}")
    near = _takes_neighborhoods(module)
    description = partial(judging_description, always=near)
    return Describing(description, partial(_described, module, near), FeatureMatching())


def _described(
    module: Trained, near: bool, thin: Clouds, descriptions: Sequence[Description], max_bytes: int
) -> DescribedClouds:
    """As ``describe_thin``, with the module's features beside."""
    described = describe_thin(thin, descriptions, max_bytes)
    parts: list[Features] = []
    with _evaluating(module), torch.no_grad():
        for cloud, description in zip(described.cloud.unpack(), descriptions, strict=True):
            if len(cloud.points) > 0:
                support = (neighbors(cloud, description.widest, description.max_neighbors),) if near else ()
                parts.append(checked_features(_answer(module, cloud, *support), cloud, "describe", "its cloud"))
                width = parts[0].values.shape[1]
                expect(parts[-1].values.shape[1] == width, "describe", f"width {width} for all", parts[-1].values)
    if not parts:
        return replace(described, outside=_nothing(described.cloud))
    values, valid = torch.cat([part.values for part in parts]), torch.cat([part.valid for part in parts])
    return replace(described, outside=Features(values, described.cloud.offsets, parts[0].blocks, valid))


def _answer(module: Trained, cloud: Clouds, *support: Neighborhoods) -> GivenFeatures:
    """What the module returns; what it raises comes out with its name and what it was given."""
    try:
        return module(cloud, *support)
    except Exception as error:
        name = getattr(module, "__name__", type(module).__name__)
        colors = "colors" if cloud.colors is not None else "without colors, which are there where both sides have them"
        near = ", and their Neighborhoods" if support else ""
        given = f"Clouds of {len(cloud.points)} points, normals, {colors}{near}"
        raise RuntimeError(f"describe: {name} raised {type(error).__name__}, given {given}: {error}") from error


def _nothing(cloud: Clouds) -> Features:
    """Features of clouds without points."""
    return Features(cloud.points[:, :1], cloud.offsets, (("features", 1),), cloud.points[:, 0] != 0)


def _takes_neighborhoods(module: Trained) -> bool:
    """Whether it needs a second argument."""
    while isinstance(inner := getattr(module, "_orig_mod", getattr(module, "module", None)), nn.Module):
        module = inner  # of one that is compiled or in parallel, whose own arguments are any
    try:
        parameters = inspect.signature(module.forward if isinstance(module, nn.Module) else module).parameters.values()
    except (TypeError, ValueError):
        return False
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    return sum(each.kind in kinds and each.default is inspect.Parameter.empty for each in parameters) > 1


@contextmanager
def _evaluating(module: Trained) -> Iterator[None]:
    """The module, where it is one, in evaluation mode; afterwards every part is in the mode that it was in."""
    training = [part for part in module.modules() if part.training] if isinstance(module, nn.Module) else []
    for part in training:
        part.training = False
    try:
        yield
    finally:
        for part in training:
            part.training = True
