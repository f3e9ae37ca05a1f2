"""Packed rows as one tensor (B, N, ...), padded to the longest item, and back."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Integral
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.errors import expect, expect_shape
from torchreg.types.packing import offsets_of, spans


class PaddedClouds(NamedTuple):
    """The rows of ``B`` clouds, each padded with zeros to the longest, N.

    ``Clouds.from_padded(*clouds.to_padded())`` gives the rows back.

    Attributes:
        points: (B, N, 3) meters, relative to the origin of each cloud.
        lengths: (B,) int64, on the device of the points: how many rows of each are points.
        colors: (B, N, 3), or ``None``.
        normals: (B, N, 3), or ``None``.
    """

    points: Tensor
    lengths: Tensor
    colors: Tensor | None = None
    normals: Tensor | None = None

    @property
    def mask(self) -> Tensor:
        """(B, N) bool, which rows are points."""
        return torch.arange(self.points.shape[1], device=self.points.device) < self.lengths[:, None]


def pad(rows: Tensor, offsets: Tensor) -> Tensor:
    """Rows (P, ...) of B items as (B, N, ...), zero behind the last of each; gradients flow."""
    parts = [rows[begin:end] for begin, end in spans(offsets)]
    if not parts:
        return rows.new_zeros(0, 0, *rows.shape[1:])
    return torch.nn.utils.rnn.pad_sequence(parts, batch_first=True)


def checked_lengths(lengths: Tensor | Sequence[int], points: Tensor) -> Tensor:
    """The offsets (B+1,) of items of these lengths (B,), of which each padded item (B, N, ...) has room."""
    expect_shape(points, "points", ("B", "N", 3), "floating")
    items, room = points.shape[:2]
    if not isinstance(lengths, Tensor):
        several = isinstance(lengths, Sequence) and not isinstance(lengths, str)
        counts = several and all(isinstance(one, Integral) and not isinstance(one, bool) for one in lengths)
        expect(counts, "lengths", "whole numbers, as a tensor (B,) or a sequence", lengths)
        lengths = torch.tensor(lengths, dtype=torch.int64, device="cpu")
    expect_shape(lengths, "lengths", (items,))
    whole = not (lengths.is_floating_point() or lengths.is_complex() or lengths.dtype == torch.bool)
    expect(whole, "lengths", "whole numbers", lengths)
    listed = lengths.tolist()
    expect(all(0 <= length <= room for length in listed), "lengths", f"numbers from 0 to {room}", listed)
    return offsets_of(listed)


def unpad(padded: Tensor, offsets: Tensor) -> Tensor:
    """The rows (P, ...) of padded items (B, N, ...); gradients flow."""
    parts = [item[: end - begin] for item, (begin, end) in zip(padded, spans(offsets), strict=True)]
    return torch.cat(parts) if parts else padded.reshape(0, *padded.shape[2:])
