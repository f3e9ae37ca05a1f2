"""A rigid transform as a file: four lines of four numbers, as numpy and CloudCompare read them."""

from __future__ import annotations

import json
import os
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import CloudFileError, expect, one_of
from torchreg.geometry.rigid_check import expect_rigid
from torchreg.io.atomic import write_text
from torchreg.io.checks import excerpt, readable_file, refuse, require
from torchreg.io.transform_formats import TRANSFORM_FORMATS

_KEY = "T_target_source"
_LARGEST_FILE = 1 << 24  # bytes


@entry
def write_transform_text(path: str | os.PathLike[str], T: Tensor, *, form: str = "matrix") -> None:
    """Write a transform (4, 4) as text, in full or not at all.

    Args:
        path: the file.
        T: rigid, translation in meters.
        form: "matrix" for four lines of four numbers with 17 digits, which float64 survives, or another name of
            ``TRANSFORM_FORMATS``.

    Raises:
        ValueError: not a rigid transform, no such form, or no such folder.

    Example:
        >>> import torch, torchreg as tr
        >>> tr.io.write_transform_text("T.txt", torch.eye(4, dtype=torch.float64))
        >>> tr.io.read_transform_text("T.txt").shape
        torch.Size([4, 4])
    """
    text = TRANSFORM_FORMATS[one_of(form, "form", tuple(TRANSFORM_FORMATS))]
    write_text(path, text(checked_rigid(T, "T")))


@entry
def read_transform_text(path: str | os.PathLike[str]) -> Tensor:
    """Read a transform (4, 4) float64 from four lines of text, or from JSON under the key "T_target_source".

    Lines of text may hold comments after ``#``. The JSON that ``write_result_json`` writes will do, unless
    the registration failed.

    Raises:
        CloudFileError: the file is missing, holds something else, or its matrix is not rigid within 1e-4.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_transform_text(f"{folder}/T.txt", torch.eye(4))
        ...     read_transform_text(f"{folder}/T.txt").shape
        torch.Size([4, 4])
    """
    file = readable_file(path)
    require(file.stat().st_size <= _LARGEST_FILE, file, "a transform of 4 x 4 numbers", "a file above 16 MB")
    text = file.read_bytes().decode("utf-8", errors="replace")
    value = _from_json(text, path) if text.lstrip().startswith("{") else _from_lines(text, path)
    try:
        return torch.from_numpy(checked_rigid(value, str(file)))
    except ValueError as error:
        raise CloudFileError(str(error)) from None


def checked_rigid(T: Tensor | ArrayLike, name: str) -> NDArray[Any]:
    """Return ``T`` as a float64 array (4, 4), checked to be a rotation and a translation within 1e-4.

    Raises:
        ValueError: another shape, numbers that are not finite, a last row other than 0 0 0 1, or an upper
            left part that is not a rotation.
    """
    values = T.detach().cpu().numpy() if isinstance(T, Tensor) else T
    try:
        matrix = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    expect(matrix.shape == (4, 4), name, "(4, 4) numbers", matrix.shape)
    expect_rigid(torch.from_numpy(matrix), name)
    return matrix


def _from_lines(text: str, path: str | os.PathLike[str]) -> list[list[float]]:
    rows = [words for line in text.splitlines() if (words := line.split("#")[0].split())]
    widths = [len(row) for row in rows]
    require(widths == [4] * 4, path, "4 lines of 4 numbers", f"{len(rows)} lines of {widths[:8]} words")
    try:
        return [[float(word) for word in row] for row in rows]
    except ValueError as error:
        refuse(path, "4 lines of 4 numbers", str(error))


def _from_json(text: str, path: str | os.PathLike[str]) -> Any:  # noqa: ANN401
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        refuse(path, "valid JSON", str(error) or type(error).__name__)
    require(_KEY in content, path, f"the key {_KEY!r}", excerpt(", ".join(content)) if content else "no key")
    require(content.get("success", True) is True, path, "a registration that succeeded", "one that failed")
    return content[_KEY]
