"""Poses of a group of pairs on their way through the verification."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation, rigid


class Run(NamedTuple):
    """The rows ``begin:end`` belong to one pair."""

    pair: int
    begin: int
    end: int


class Poses(NamedTuple):
    """H poses of G pairs, between the frames of ``points`` (origins left out).

    Attributes:
        rotation: (H, 3, 3) float64.
        translation: (H, 3) float64, meters.
        origin: (H,) int64, which proposal each came from; probes have negative numbers.
        pair: (H,) int64, which pair each belongs to; ascending, except between ``joined`` and an ordering.
    """

    rotation: Tensor
    translation: Tensor
    origin: Tensor
    pair: Tensor

    def take(self, rows: Tensor | slice) -> Poses:
        """The poses ``rows`` (K,), in that order."""
        return Poses(*(part[rows] for part in self))

    def matrices(self) -> Tensor:
        """(H, 4, 4)."""
        return rigid(self.rotation, self.translation)

    def moved(self, T: Tensor) -> Poses:
        """The same with other transforms (H, 4, 4)."""
        return self._replace(rotation=T[:, :3, :3], translation=T[:, :3, 3])

    def vectors(self, frames: Tensor) -> Tensor:
        """(12, H), whose distances are rms displacements of points, meters.

        As ``torchreg.solvers.poses.pose_vectors``.

        Args:
            frames: (G, 4, 3) of every pair's points: the columns of a root of their covariance, and their mean.
        """
        turned = apply_rotation(self.rotation[:, None], frames[self.pair])  # (H, 4, 3)
        turned[:, 3] += self.translation
        return turned.flatten(1).t().contiguous()


def joined(parts: Sequence[Poses]) -> Poses:
    """All poses of the parts, in order."""
    return Poses(*(torch.cat(values) for values in zip(*parts, strict=True)))


def runs_of(pair: Tensor) -> list[Run]:
    """Where the rows of each pair stand, by their pairs (H,), ascending; pairs without rows have no run."""
    begin, runs = 0, []
    for number, members in groupby(pair.tolist()):
        end = begin + len(list(members))
        runs.append(Run(number, begin, end))
        begin = end
    return runs


def distinct(vectors: Tensor, pair: Tensor, apart: Tensor) -> list[int]:
    """Rows of the poses that move their points farther than ``apart`` from all that were kept before them.

    Args:
        vectors: (12, H), as ``Poses.vectors``, the poses of each pair from the best down.
        pair: (H,) int64, ascending.
        apart: (G,) float64, meters, of every pair.
    """
    kept = []
    for run, far in zip(runs_of(pair), _far(vectors, pair, apart), strict=True):
        left = list(range(run.end - run.begin))
        while left:
            first = left[0]
            kept.append(run.begin + first)
            left = [other for other in left[1:] if far[first][other]]
    return kept


def _far(vectors: Tensor, pair: Tensor, apart: Tensor) -> list[list[list[bool]]]:
    """For every pair that has poses, which of them are far from which."""
    runs = runs_of(pair)
    most = max(run.end - run.begin for run in runs)
    first = torch.tensor([run.begin for run in runs], device=pair.device)
    # rows of the last pose where a pair has fewer: they are never read
    rows = (first[:, None] + torch.arange(most, device=pair.device)).clamp(max=len(pair) - 1)  # (g, most)
    square = torch.zeros(*rows.shape, most, dtype=vectors.dtype, device=pair.device)
    for line in vectors.unbind(0):
        difference = line[rows][:, None] - line[rows][:, :, None]
        square += difference * difference
    found: list[list[list[bool]]] = (square > apart[pair[first], None, None].square()).tolist()
    return found
