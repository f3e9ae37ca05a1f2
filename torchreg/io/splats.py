"""Gaussian splats as PLY: centers as points, the constant part of their color, faint ones dropped.

The color of a splat is 0.5 + 0.28209... f_dc (the spherical harmonic of degree 0), cut to [0, 1]; its opacity is the
logistic function of what the file holds. Kerbl et al., 3D Gaussian Splatting, 2023, https://doi.org/10.1145/3592433.
"""

from __future__ import annotations

import math

import numpy as np

from torchreg.io.assemble import RawCloud
from torchreg.io.column_colors import CHANNELS
from torchreg.io.columns import Columns, raw_from_columns
from torchreg.io.placement import Scanner

FAINT = 0.1
"""Splats of less opacity are no surface and are left out."""

_HARMONICS = ("f_dc_0", "f_dc_1", "f_dc_2")
_OPACITY = "opacity"
_CONSTANT_HARMONIC = 0.5 / math.sqrt(math.pi)


def holds_splats(columns: Columns) -> bool:
    """Whether named columns are those of Gaussian splats."""
    return {*_HARMONICS, _OPACITY} <= columns.keys()


def raw_from_splats(
    name: str, kind: str, columns: Columns, scanner: Scanner | None = None, notes: tuple[str, ...] = ()
) -> RawCloud:
    """The cloud of the centers of splats; their columns nx, ny, nz hold nothing and are not read.

    Raises:
        CloudFileError: one of x, y, z is missing.
    """
    opacity = columns[_OPACITY].astype(np.float64)
    with np.errstate(over="ignore"):
        kept = ~(1 / (1 + np.exp(-opacity)) < FAINT)  # (N,); NaN says nothing and is kept
    faint = int(np.count_nonzero(~kept))
    if not kept.any():
        kept, faint = np.ones_like(kept), 0
        notes = (*notes, f"all splats have an opacity below {FAINT:g}: none was left out")
    harmonics = np.stack([columns[word] for word in _HARMONICS], axis=1).astype(np.float64)  # (N, 3)
    colors = 0.5 + _CONSTANT_HARMONIC * np.where(np.isfinite(harmonics), harmonics, 0)
    places: Columns = {word: columns[word][kept] for word in ("x", "y", "z") if word in columns}
    places |= dict(zip(CHANNELS[0], np.clip(colors, 0, 1)[kept].T, strict=True))
    if faint:
        notes = (*notes, f"{faint:,} of {len(opacity):,} splats have an opacity below {FAINT:g} and were left out")
    return raw_from_columns(name, f"{kind}, Gaussian splats", places, scanner, notes)
