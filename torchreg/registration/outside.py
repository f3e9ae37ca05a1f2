"""Features and matches that were computed elsewhere, checked and brought into the form that pairs are matched by."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.descriptors.descriptor import largest_entries
from torchreg.errors import expect, expect_device, expect_floating, expect_in_words, expect_shape
from torchreg.registration.rivals import NearMatches
from torchreg.types import Clouds, Correspondences, Features
from torchreg.types.packing import spans

NAME = "features"
"""Of the block of features that come without a name."""


class KeypointFeatures(NamedTuple):
    """Features of some of the points of a batch of clouds.

    Attributes:
        rows: (K,) int64, which points, as rows of the packed batch, each at most once, in any order.
        values: (K, D) floating point.

    Example:
        >>> import torch, torchreg as tr
        >>> keypoints = tr.KeypointFeatures(rows=torch.tensor([0, 4, 7]), values=torch.rand(3, 32))
        >>> keypoints.values.shape
        torch.Size([3, 32])
    """

    rows: Tensor
    values: Tensor


GivenFeatures = Tensor | Features | KeypointFeatures
"""Of the points of B clouds: (P, D) one row per point, ``Features`` with their offsets, or those of keypoints."""

GivenMatches = Tensor | Correspondences | Sequence[Tensor]
"""Of B pairs: ``Correspondences``, or index pairs (M, 2) of every pair, rows of its own two clouds."""


class BothSides(NamedTuple):
    """Features of the sources and the targets of pairs, comparable: of one width and dtype."""

    source: Features
    target: Features


def both_sides(source: Clouds, target: Clouds, f: GivenFeatures, g: GivenFeatures) -> BothSides:
    """The features of both sides of pairs, half precision widened to float32.

    Raises:
        TypeError: features of another type.
        ValueError: another number of rows, width, dtype or device, or numbers that are not finite.
    """
    one, other = checked_features(f, source, "f", "source"), checked_features(g, target, "g", "target")
    width = one.values.shape[1]
    expect(other.values.shape[1] == width, "g", f"features of width {width}, as f", other.values)
    dtype = torch.promote_types(one.values.dtype, other.values.dtype)
    return BothSides(*(_in_dtype(side, dtype) for side in (one, other)))


def checked_features(given: GivenFeatures, clouds: Clouds, name: str, of: str) -> Features:
    """The features of every point of B clouds, in float32 or float64, without gradients.

    A row of zeros describes nothing and is not valid, where nothing else says what is; nor is a point that is no
    keypoint.

    Args:
        given: in any of the forms.
        clouds: those that are described.
        name: of the argument, for messages.
        of: what the clouds are, for messages.

    Raises:
        TypeError: features of another type.
        ValueError: as of ``both_sides``.
    """
    points = len(clouds.points)
    if isinstance(given, KeypointFeatures):
        rows = _keypoints(given, clouds, name, of)
        some = _finite_rows(given.values, f"{name}.values")
        expect_device(some, f"{name}.values", clouds.device)
        expect(len(some) == len(rows), f"{name}.values", f"a row for each of {len(rows)} keypoints", given.values)
        values = some.new_zeros(points, some.shape[1])
        values[rows] = some
        return Features(values, clouds.offsets, ((NAME, values.shape[1]),), _described(values))
    if isinstance(given, Features):
        fits = torch.equal(given.offsets, clouds.offsets)
        expect(fits, name, f"the offsets of {of}, {_listed(clouds.offsets)}", _listed(given.offsets))
        values = _finite_rows(given.values, f"{name}.values", given.valid)
        expect_device(values, name, clouds.device)
        return Features(values, clouds.offsets, given.blocks, given.valid)
    if not isinstance(given, Tensor):
        kind = type(given).__name__
        raise TypeError(f"{name}: expected a tensor (P, D), Features or KeypointFeatures, got {kind}")
    values = _finite_rows(given, name)
    expect(len(values) == points, name, f"a row for each of {points} points of {of}", given)
    expect_device(values, name, clouds.device)
    return Features(values, clouds.offsets, ((NAME, values.shape[1]),), _described(values))


def checked_matches(matches: GivenMatches, source: Clouds, target: Clouds) -> list[NearMatches]:
    """The matches of every pair, as rows of its own two clouds.

    Raises:
        TypeError: matches of another type.
        ValueError: another number of pairs, shape, dtype or device, or rows that a cloud does not have.
    """
    if isinstance(matches, Correspondences):
        expect(len(matches) == len(source), "matches", f"{len(source)} pairs, as source has clouds", len(matches))
        expect_device(matches.source, "matches", source.device)
        firsts = zip(spans(matches.offsets), source.offsets.tolist(), target.offsets.tolist(), strict=False)
        pairs = [
            NearMatches(matches.source[begin:end] - i, matches.target[begin:end] - j, matches.score[begin:end].detach())
            for (begin, end), i, j in firsts
        ]
        return [_of_pair(pair, b, source, target) for b, pair in enumerate(pairs)]
    several = [matches] if isinstance(matches, Tensor) else matches
    if not isinstance(several, Sequence) or not all(isinstance(each, Tensor) for each in several):
        kind = type(matches).__name__
        raise TypeError(f"matches: expected index pairs (M, 2) of every pair, or Correspondences, got {kind}")
    wanted = f"index pairs (M, 2), as torch.stack([i, j], dim=1), for each of {len(source)} pairs"
    expect(len(several) == len(source), "matches", wanted, len(several))
    return [_of_pair(_columns(each, source), b, source, target) for b, each in enumerate(several)]


def _columns(pairs: Tensor, source: Clouds) -> NearMatches:
    """Index pairs (M, 2) of one pair of clouds, all of score zero."""
    expect_shape(pairs, "matches", ("M", 2))
    whole = not (pairs.is_floating_point() or pairs.is_complex() or pairs.dtype == torch.bool)
    expect(whole, "matches", "whole numbers", pairs)
    expect_device(pairs, "matches", source.device)
    i, j = pairs.long().unbind(dim=1)
    return NearMatches(i.contiguous(), j.contiguous(), torch.zeros(len(i), device=pairs.device))


def _of_pair(matches: NearMatches, b: int, source: Clouds, target: Clouds) -> NearMatches:
    for name, rows, count in (
        ("source", matches.source, source.lengths[b]),
        ("target", matches.target, target.lengths[b]),
    ):
        outside = (rows < 0) | (rows >= count)
        if bool(outside.any()):
            which = int(rows[outside.nonzero()[0, 0]])
            expect(False, "matches", f"rows 0 to {count - 1} of the {count} points of {name} {b}", which)
    return matches


def _keypoints(given: KeypointFeatures, clouds: Clouds, name: str, of: str) -> Tensor:
    expect_shape(given.rows, f"{name}.rows", ("K",), torch.int64, clouds.device)
    points, rows = len(clouds.points), given.rows
    legal = bool(((rows >= 0) & (rows < points)).all())
    if not legal:
        expect(False, f"{name}.rows", f"rows 0 to {points - 1} of {of}", [int(row) for row in rows.aminmax()])
    distinct = len(rows.unique())
    expect_in_words(
        distinct == len(rows),
        f"{name}.rows",
        "every row at most once",
        f"{len(rows)} rows, {distinct} of them different",
    )
    return rows


def _finite_rows(values: Tensor, name: str, valid: Tensor | None = None) -> Tensor:
    """Checked values (P, D), detached, in float32 or float64."""
    expect_shape(values, name, ("P", "D"))
    expect_floating(values, name)
    expect(values.shape[1] > 0, name, "at least one column", values)
    wide = values.detach() if values.dtype in (torch.float32, torch.float64) else values.detach().float()
    broken = ~torch.isfinite(largest_entries(wide))
    if valid is not None:
        broken &= valid
    expect_in_words(
        not bool(broken.any()), name, "finite numbers", f"NaN or infinity in {int(broken.sum())} of {len(wide)} rows"
    )
    return wide


def _described(values: Tensor) -> Tensor:
    return largest_entries(values) != 0


def _in_dtype(side: Features, dtype: torch.dtype) -> Features:
    return Features(side.values.to(dtype), side.offsets, side.blocks, side.valid)


def _listed(offsets: Tensor) -> list[int]:
    listed: list[int] = offsets.tolist()
    return listed
