"""Adapters: how someone's network is asked for the features or matches of a pair, whatever library it is from.

An adapter is a callable, or a class of one (a network with its weights, say) that is made without arguments. It takes

    one cloud               and returns its features: (P, D), ``Features`` or ``KeypointFeatures``
    source and target       and returns both their features, (f, g), or their matches: (M, 2) or ``Correspondences``

as ``register_features`` and ``register_matches`` take them; clouds are ``Clouds`` of one, means over voxels. An adapter
is named ``module:callable``; the module is imported from the working directory or the environment.
"""

from __future__ import annotations

import importlib
import inspect
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

import torchreg as tr
from torchreg.benchmark.peers.method import Answer, Method, PeerMatches, Task
from torchreg.errors import expect, expect_in_words
from torchreg.registration.outside import GivenFeatures, GivenMatches, both_sides, checked_matches
from torchreg.types import Clouds, Correspondences

Adapter = Callable[..., Any]
"""Of one cloud or of two, as above."""


class Described(NamedTuple):
    """The features of both clouds of a pair."""

    f: GivenFeatures
    g: GivenFeatures


EFFORTS = {"plain": ", matches alone", "balanced": ""}
"""Efforts that features become poses at, and words for the method: that most matches agree on, or that clouds decide.

What matches alone find is the features' own. Where the clouds decide, poses tried beside theirs are found as well.
"""


def adapter_methods(name: str) -> list[Method]:
    """The methods of an adapter, by its name ``module:callable``.

    Raises:
        ValueError: no such module or callable, or one that takes neither one cloud nor two.
    """
    adapter = loaded(name)
    both = _clouds_of(adapter, name) == 2
    given = f"`{name}`, for {'both clouds of a pair' if both else 'each cloud'}"
    return _methods(name, name, given, lambda task: _answered(adapter, *_clouds(task), both=both))


def loaded(name: str) -> Adapter:
    """What ``module:callable`` names; where it is a class, an object of it.

    Raises:
        ValueError: as of ``adapter_methods``.
    """
    module, _, path = name.partition(":")
    expect(bool(module) and bool(path), "adapter", "module:callable, such as my_network:describe", name)
    try:
        found = _imported(module)
        for part in path.split("."):
            found = getattr(found, part)
    except (ImportError, AttributeError) as problem:
        raise ValueError(f"adapter: expected a callable that can be imported, got {name!r} ({problem})") from None
    adapter: Adapter = found() if isinstance(found, type) else found
    expect_in_words(callable(adapter), "adapter", "a callable", f"{name} of type {type(adapter).__name__}")
    return adapter


def registered(task: Task, given: Described | GivenMatches, effort: str) -> Answer:
    """The answer by features or matches of a task's clouds, with the matches that they are judged by.

    These are the mutual nearest neighbors of features, or the matches given, whichever others were tried too.
    """
    source, target = _clouds(task)
    colored = source.colors is not None and target.colors is not None
    options = tr.options_for(task.voxel, colored=colored, effort=effort)
    if isinstance(given, Described):
        matches = tr.match_mutual(*both_sides(source, target, *given))
        result = tr.register_features(source, target, *given, options, seed=task.seed)
    else:
        (pair,) = checked_matches(given, source, target)
        matches = Correspondences(pair.source, pair.target, torch.tensor([0, len(pair.source)]), pair.score)
        result = tr.register_matches(source, target, matches, options, seed=task.seed)
    on_cpu = Correspondences(matches.source.cpu(), matches.target.cpu(), matches.offsets, matches.score.cpu())
    return Answer(
        T_target_source=result.T_target_source[0].cpu(),
        success=bool(result.success[0]),
        matches=PeerMatches(task.source, task.target, on_cpu),
    )


def _methods(name: str, title: str, given: str, describe: Callable[[Task], Described | GivenMatches]) -> list[Method]:
    """One for every effort."""
    how = {
        "plain": "the pose that most mutual matches agree on, by compatibility graph",
        "balanced": "poses weighed on the clouds and refined by ICP, as by the default",
    }

    def method(effort: str, words: str) -> Method:
        return Method(
            name=f"{name}{words.replace(', ', '/').replace(' ', '-')}",
            title=f"{title}{words}",
            statement=f"{given}; {how[effort]}.",
            run=lambda task: registered(task, describe(task), effort),
        )

    return [method(effort, words) for effort, words in EFFORTS.items()]


def _clouds(task: Task) -> tuple[Clouds, Clouds]:
    return task.source.to(task.device), task.target.to(task.device)


def _fpfh(task: Task) -> Described:
    described = []
    for cloud in _clouds(task):
        near = tr.neighbors(cloud, task.feature_radius, 100)
        turned = tr.estimate_normals(cloud, near.restrict(task.normal_radius, 30))
        described.append(tr.fpfh(turned, near).values)
    return Described(*described)


FPFH = _methods("fpfh-features", "FPFH as given features", "FPFH of 5 voxels as plain tensors", _fpfh)
"""What adapters stand beside: the same ways from features to poses."""


def _answered(adapter: Adapter, source: Clouds, target: Clouds, *, both: bool) -> Described | GivenMatches:
    """What an adapter returns for a pair, without gradients."""
    with torch.no_grad():
        if not both:
            return Described(adapter(source), adapter(target))
        answer = adapter(source, target)
    if isinstance(answer, tuple) and len(answer) == 2 and not isinstance(answer, tr.KeypointFeatures):
        return Described(*answer)
    fits = isinstance(answer, Tensor | Correspondences)
    expect(fits, "adapter", "features (f, g), or matches (M, 2) or Correspondences", type(answer).__name__)
    matches: GivenMatches = answer
    return matches


def _imported(module: str) -> Any:  # noqa: ANN401
    """A module, from the working directory or the environment."""
    here = str(Path.cwd())
    sys.path.insert(0, here)
    try:
        return importlib.import_module(module)
    finally:
        sys.path.remove(here)


def _clouds_of(adapter: Adapter, name: str) -> int:
    """How many clouds an adapter takes: 1 or 2."""
    forward = getattr(adapter, "forward", adapter)  # of a network, whose call takes anything
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    parameters = [each for each in inspect.signature(forward).parameters.values() if each.kind in kinds]
    needed = sum(each.default is inspect.Parameter.empty for each in parameters)
    expect_in_words(
        needed in (1, 2), "adapter", "a callable of one cloud, or of source and target", f"{name} of {needed}"
    )
    return needed
