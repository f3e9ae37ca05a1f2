"""The points that the matches of a result speak of."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from torchreg.errors import expect
from torchreg.registration.describe import downsample
from torchreg.registration.inspect import refuse, set_aside
from torchreg.report.thinning import thin
from torchreg.types import Clouds, RegistrationResult
from torchreg.types.packing import spans


class Matched(NamedTuple):
    """The matches of one pair as places.

    Attributes:
        source: (M, 3) float64, meters, relative to the source's origin.
        target: (M, 3) float64, meters, relative to the target's origin.
        inlier: (M,) bool.
    """

    source: NDArray[Any]
    target: NDArray[Any]
    inlier: NDArray[Any]


def matched_points(source: Clouds, target: Clouds, result: RegistrationResult, pair: int) -> Matched:
    """Look up both ends of every match of one pair.

    The rows of ``result.correspondences`` are those of the clouds that were matched: those given to ``ransac``, in
    ``register`` the downsampled ones, which are computed once more from the clouds and the result's options.

    Args:
        source: the B clouds that were registered.
        target: likewise.
        result: of these B pairs.
        pair: which one.

    Raises:
        ValueError: another number of clouds, a ``pair`` out of range, or rows that the clouds do not have.
    """
    pairs = len(result)
    for name, clouds in (("source", source), ("target", target)):
        expect(len(clouds) == pairs, name, f"the {pairs} clouds that were registered", f"{len(clouds)} clouds")
    expect(0 <= pair < pairs, "pair", f"a number from 0 to {pairs - 1}", pair)
    source, target = source.to("cpu"), target.to("cpu")
    if result.options:
        refused = refuse(source, target)
        source, target = set_aside(source, refused), set_aside(target, refused)
        source, target = downsample(source, result.options), downsample(target, result.options)
    begin, end = spans(result.correspondences.offsets)[pair]
    inlier: NDArray[Any] = result.inliers[begin:end].cpu().numpy()
    return Matched(
        _rows(source, result.correspondences.source[begin:end], pair, "source"),
        _rows(target, result.correspondences.target[begin:end], pair, "target"),
        inlier,
    )


def drawn_matches(matched: Matched, count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which inliers and which outliers to draw, at most ``count`` together, spread over the source.

    Each kind gets its share of the matches, yet at least a fifth where it has as many, so that neither goes unseen.
    The same matches give the same choice.
    """
    kinds = [np.flatnonzero(matched.inlier), np.flatnonzero(~matched.inlier)]
    total = max(len(matched.inlier), 1)
    least = [min(len(rows), -(-count // 5)) for rows in kinds]
    first = min(max(round(count * len(kinds[0]) / total), least[0]), count - least[1])
    quota = (first, count - first)
    inlier, outlier = (rows[thin(matched.source[rows], most)] for rows, most in zip(kinds, quota, strict=True))
    return inlier, outlier


def _rows(cloud: Clouds, rows: Tensor, pair: int, name: str) -> NDArray[Any]:
    """Points (M, 3) at global rows, which must be those of the pair's own cloud."""
    begin, end = spans(cloud.offsets)[pair]
    rows = rows.cpu()
    inside = bool(((rows >= begin) & (rows < end)).all())
    expect(inside, name, "the cloud that was registered", f"one of {end - begin} points without the matched rows")
    found: NDArray[Any] = cloud.points.detach()[rows].double().numpy()
    return found
