"""The scanner's position as words in a comment, which formats without a field for it, or for a guess, may hold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from torchreg.io.placement import Scanner, scanner_of_file, viewpoint_or_nan
from torchreg.types import Clouds

KNOWN, ASSUMED = "viewpoint", "viewpoint_assumed"


def viewpoint_line(cloud: Clouds) -> str:
    """The viewpoint of one cloud as "viewpoint x y z", in the frame of the file; NaN where it is not known."""
    word = ASSUMED if bool(cloud.viewpoint_assumed[0]) else KNOWN
    x, y, z = (viewpoint_or_nan(cloud) + cloud.origin[0]).tolist()
    return f"{word} {x:.17g} {y:.17g} {z:.17g}"


def scanner_of_line(words: Sequence[str]) -> Scanner | None:
    """The scanner that the words of a comment give; ``None`` for any other comment."""
    if len(words) != 4 or words[0] not in (KNOWN, ASSUMED):
        return None
    try:
        return scanner_of_file(np.array([float(word) for word in words[1:]]), assumed=words[0] == ASSUMED)
    except ValueError:
        return None
