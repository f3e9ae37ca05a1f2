"""Intensity as gray colors, for clouds without colors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from torchreg.io.assemble import RawCloud, of_one_color

DARK, BRIGHT = 2.0, 98.0
"""Percentiles of the intensity that become black and white."""


def with_gray_colors(raw: RawCloud, *, asked_for: bool) -> RawCloud:
    """The cloud with its intensity as gray colors in [0, 1], if it has no colors, or one only, and that is asked for.

    The intensity between its 2nd and 98th percentile is stretched to [0, 1]: its scale differs with scanner and
    format, and few returns are far brighter than all others. A note says what was done, or could be.
    """
    if raw.intensity is None or (raw.colors is not None and not of_one_color(raw.colors)):
        return raw
    if not asked_for:
        note = "no colors, but intensity: intensity=True (--intensity) makes it gray colors in register and convert"
        return replace(raw, notes=(*raw.notes, note))
    finite = np.isfinite(raw.intensity)
    values = np.where(finite, raw.intensity, 0).astype(np.float64)
    if not finite.any():
        return raw
    low, high = np.percentile(values[finite], (DARK, BRIGHT))
    if not high > low:
        low, high = values[finite].min(), values[finite].max()
    if not high > low:
        return raw
    gray = np.where(finite, np.clip((values - low) / (high - low), 0, 1), 0)
    note = f"no colors: intensity from {low:g} to {high:g} is used as gray colors"
    return replace(raw, colors=np.repeat(gray[:, None], 3, axis=1), color_depth="intensity", notes=(*raw.notes, note))
