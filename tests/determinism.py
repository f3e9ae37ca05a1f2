"""Bit-for-bit comparison, and the things that must not change a bit: threads and the size of pieces."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

import pytest
import torch
from torch import Tensor

from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.types import Clouds

THREADS = (1, 2, 3, 8)  # 8: matrix products are cut in another way there

# by name, since some modules share theirs with the function that a package takes from them
_CHUNKED = (
    "descriptors.contrast",
    "descriptors.fpfh",
    "descriptors.histograms",
    "descriptors.local_frames",
    "descriptors.neighbor_pairs",
    "descriptors.pcfh",
    "descriptors.shape_context",
    "descriptors.shot",
    "descriptors.soft.rows",
    "descriptors.soft.spread",
    "descriptors.learned",
    "preprocess.normals",
    "solvers.chance",
)
_TILED = ("matching.nearest", "solvers.scoring")


def same_bits(left: Any, right: Any, *, ignore: tuple[str, ...] = ()) -> bool:
    """Whether two tensors, or dataclasses and tuples of them, hold the same bits."""
    if isinstance(left, Tensor):
        return _same_tensors(left, right)
    if dataclasses.is_dataclass(left):
        names = [field.name for field in dataclasses.fields(left) if field.name not in ignore]
        return all(same_bits(getattr(left, name), getattr(right, name), ignore=ignore) for name in names)
    if isinstance(left, tuple):
        return len(left) == len(right) and all(
            same_bits(one, other, ignore=ignore) for one, other in zip(left, right, strict=True)
        )
    return left == right or (left != left and right != right)  # NaN


def _same_tensors(left: Tensor, right: Tensor) -> bool:
    if left.dtype != right.dtype or left.shape != right.shape:
        return False
    if left.is_floating_point():  # NaN equals NaN here, and 0.0 is not -0.0
        whole = {4: torch.int32, 8: torch.int64}[left.element_size()]
        left, right = left.contiguous().view(whole), right.contiguous().view(whole)
    return torch.equal(left, right)


@contextmanager
def threads(number: int) -> Iterator[None]:
    """Run with this many threads inside an operation, then with as many as before."""
    before = torch.get_num_threads()
    torch.set_num_threads(number)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def pieces(elements: int, tile_elements: int | None = None) -> Iterator[None]:
    """Run with chunks of about this many elements in every chunked kernel, and with tiles of ``tile_elements``."""

    def chunks(rows: int, width: int, _: int = 0) -> Iterator[slice]:
        return row_chunks(rows, width, elements)

    with pytest.MonkeyPatch.context() as patch:
        for name in _CHUNKED:
            patch.setattr(import_module(f"torchreg.{name}"), "row_chunks", chunks)
        for name in _TILED if tile_elements is not None else ():
            patch.setattr(import_module(f"torchreg.{name}"), "_TILE_ELEMENTS", tile_elements)
        yield


def assert_nothing_shows(run: Callable[[], Any], *, ignore: tuple[str, ...] = ()) -> None:
    """Run with other numbers of threads, other chunks and other tiles: every run must give the same bits."""
    expected = run()
    assert same_bits(run(), expected, ignore=ignore), "another run"
    for number in THREADS:
        for elements, tile_elements in ((1 << 30, 1 << 24), (3001, 1 << 15)):
            with threads(number), pieces(elements, tile_elements):
                case = f"{number} threads, chunks of {elements}, tiles of {tile_elements}"
                assert same_bits(run(), expected, ignore=ignore), case


def assert_batch_equals_loop(run: Callable[[Clouds], tuple[Tensor, ...]], clouds: list[Clouds]) -> None:
    """Run on a packed batch, in both orders, and on each of its clouds: the same rows, bit for bit.

    Empty clouds and one of a single point join the clouds given.
    """
    rows = [torch.zeros(0, dtype=torch.int64), torch.tensor([7])]
    empty, single = (clouds[0].rows(row, torch.tensor([0, len(row)])) for row in rows)
    batch = [empty, clouds[0], empty, *clouds[1:], single]
    for ordered in (batch, batch[::-1]):
        alone = [run(cloud) for cloud in ordered]
        assert same_bits(run(Clouds.pack(ordered)), tuple(map(torch.cat, zip(*alone, strict=True))))
