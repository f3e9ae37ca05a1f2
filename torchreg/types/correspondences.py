"""Pairs of points that may be the same place: listed one by one, or as a confidence for every pair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.errors import expect, expect_shape
from torchreg.types.held import Held, Listed, Offsets, PerRow, bounds_of, held
from torchreg.types.packing import checked_offsets, offsets_of, spans
from torchreg.types.record import PackedBatch
from torchreg.types.shown import counted, several, where


@checked_record
@dataclass(frozen=True, eq=False, repr=False)
class Correspondences(PackedBatch):
    """Putative matches of ``B`` pairs of clouds, packed.

    Rows are those of the whole batches of clouds, also in ``matches[b]``; a result that is indexed has rows of its own
    clouds (``RegistrationResult``).

    Attributes:
        source: (M,) int64, global rows of the source batch.
        target: (M,) int64, global rows of the target batch.
        offsets: (B+1,) int64, on the CPU; pair ``b`` holds the matches ``offsets[b]:offsets[b+1]``.
        score: (M,) floating point; the matcher's distance in feature space: the smaller, the better.

    Example:
        >>> import torch, torchreg as tr
        >>> rows = torch.tensor([0, 1, 2])
        >>> matches = tr.Correspondences(rows, rows.flip(0), offsets=torch.tensor([0, 3]), score=torch.zeros(3))
        >>> len(matches)
        1
    """

    source: Tensor = held(PerRow())
    target: Tensor = held(PerRow())
    offsets: Tensor = held(Offsets())
    score: Tensor = held(PerRow(casts=True))

    def __post_init__(self) -> None:
        expect_shape(self.source, "source", ("M",), torch.int64)
        count, device = self.source.shape[0], self.source.device
        expect_shape(self.target, "target", (count,), torch.int64, device)
        expect_shape(self.score, "score", (count,), "floating", device)
        object.__setattr__(self, "offsets", checked_offsets(self.offsets, count))

    def __len__(self) -> int:
        """The number of pairs, B."""
        return len(self.offsets) - 1

    def counted_on(self, source: Tensor, target: Tensor) -> Correspondences:
        """The same matches, ``source[b]`` and ``target[b]`` (B,) int64 added to the rows of pair ``b``."""
        counts = self.offsets.diff()
        shifts = (each.repeat_interleave(counts).to(self.source.device) for each in (source, target))
        return replace(self, source=self.source + next(shifts), target=self.target + next(shifts))

    def _facts(self) -> Sequence[str]:
        return (
            f"{counted(self.offsets.diff().tolist())} matches of {several(len(self), 'pairs')}",
            f"scores {where(self.score)}",
        )


@dataclass(frozen=True, kw_only=True)
class MatchesBetween(Held):
    """A field with the matches between the clouds of two others: their rows are those of these clouds alone."""

    source: str = "source"
    target: str = "target"

    def picked(self, value: Any, batch: Any, numbers: Sequence[int]) -> Any:  # noqa: ANN401
        """The matches of these pairs, in the rows of their clouds."""
        matches: Correspondences = value[list(numbers)]

        def shift(side: str) -> Tensor:
            bounds = bounds_of(getattr(batch, side).offsets, numbers)
            before = torch.tensor([begin for begin, _ in bounds], dtype=torch.int64)
            return offsets_of(end - begin for begin, end in bounds)[:-1] - before

        return matches.counted_on(shift(self.source), shift(self.target))

    def joined(self, values: Sequence[Any], name: str, batches: Sequence[Any]) -> Any:  # noqa: ANN401
        """The matches of all pairs; rows count on through all clouds."""
        pairs = torch.tensor([len(value) for value in values])

        def shift(side: str) -> Tensor:
            sizes = (int(getattr(batch, side).offsets[-1]) for batch in batches)
            return offsets_of(sizes)[:-1].repeat_interleave(pairs)

        matches: Correspondences = Correspondences.pack(values)
        return matches.counted_on(shift(self.source), shift(self.target))


@checked_record
@dataclass(frozen=True, eq=False, repr=False)
class SoftCorrespondences(PackedBatch):
    """Soft matches of ``B`` pairs of clouds: one dense matrix each, since every point may match every other.

    Attributes:
        confidence: B matrices (N_b, M_b) floating point, not below 0: row i, column j is the confidence that source
            point i and target point j of the pair are the same place. Rows and columns sum to 1 at most (nearly, where
            Sinkhorn has not converged). Zero where a point has no valid descriptor.
        source_offsets: (B+1,) int64, on the CPU, of the packed source clouds; N_b = their differences.
        target_offsets: (B+1,) int64, likewise of the target clouds.

    Example:
        >>> import torch, torchreg as tr
        >>> rows = tr.Features(torch.eye(3), torch.tensor([0, 3]), (("any", 3),), torch.tensor([True, True, True]))
        >>> tr.soft_match(rows, rows).confidence[0].shape
        torch.Size([3, 3])
    """

    confidence: tuple[Tensor, ...] = held(Listed(casts=True))
    source_offsets: Tensor = held(Offsets())
    target_offsets: Tensor = held(Offsets())

    def __post_init__(self) -> None:
        pairs = len(self.confidence)
        for name in ("source_offsets", "target_offsets"):
            offsets = getattr(self, name)
            expect_shape(offsets, name, (pairs + 1,))
            if torch.compiler.is_compiling():  # where values are not known
                return
            object.__setattr__(self, name, checked_offsets(offsets, int(offsets[-1]), name))
        rows, columns = spans(self.source_offsets), spans(self.target_offsets)
        for matrix, (i, j), (k, m) in zip(self.confidence, rows, columns, strict=True):
            expect_shape(matrix, "confidence", (j - i, m - k), "floating", self.confidence[0].device)
            expect(matrix.dtype == self.confidence[0].dtype, "confidence", "matrices of one dtype", matrix)

    def __len__(self) -> int:
        """The number of pairs, B."""
        return len(self.confidence)

    def _facts(self) -> Sequence[str]:
        sizes = (tuple(matrix.shape) for matrix in self.confidence)
        return (
            f"{several(len(self), 'pairs')} of "
            + (", ".join(f"{rows:,} x {columns:,}" for rows, columns in sizes) or "no points"),
            *(where(matrix) for matrix in self.confidence[:1]),
        )
