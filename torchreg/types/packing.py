"""Offsets of a packed batch: rows of all items one after another, item ``b`` in ``offsets[b]:offsets[b+1]``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import accumulate, pairwise

import torch
from torch import Tensor

from torchreg.errors import expect, expect_in_words, expect_shape


def checked_offsets(offsets: Tensor, rows: int, name: str = "offsets") -> Tensor:
    """Return ``offsets`` on the CPU after checking that they are int64, start at 0, ascend and end at ``rows``.

    Python loops over clouds read them, so they are on the CPU whatever the device of the rows.
    """
    expect_shape(offsets, name, ("B+1",), torch.int64)
    if torch.compiler.is_compiling():  # where values are not known
        return offsets
    offsets = offsets.cpu()
    listed = offsets.tolist()
    ascending = all(low <= high for low, high in pairwise(listed))
    expect(
        len(listed) >= 1 and listed[0] == 0 and listed[-1] == rows and ascending,
        name,
        f"ascending numbers from 0 to {rows}",
        listed,
    )
    return offsets


def offsets_of(lengths: Iterable[int]) -> Tensor:
    """Offsets (B+1,) int64 of items of these lengths."""
    return torch.tensor([0, *accumulate(lengths)], dtype=torch.int64, device="cpu")


def kept_rows(offsets: Tensor, left_out: Sequence[object]) -> tuple[Tensor, Tensor]:
    """The rows (Q,), on the CPU, of all items but those left out (true), and the offsets (B+1,) with these empty."""
    kept = [slice(begin, begin if out else end) for (begin, end), out in zip(spans(offsets), left_out, strict=True)]
    rows = torch.cat([torch.arange(part.start, part.stop) for part in kept]) if kept else torch.arange(0)
    return rows, offsets_of(part.stop - part.start for part in kept)


def spans(offsets: Tensor, rows: int | None = None) -> list[tuple[int, int]]:
    """The (begin, end) rows of every item.

    Where a graph is captured no value is read: it holds for one item of all ``rows``.
    """
    if rows is not None and torch.compiler.is_compiling():
        expect_in_words(
            offsets.shape[0] == 2, "offsets", "one cloud, where a graph is captured", f"{offsets.shape[0] - 1}"
        )
        return [(0, rows)]
    listed: list[int] = offsets.tolist()
    return list(pairwise(listed))
