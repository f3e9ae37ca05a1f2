"""Whether a found transform may be called a success."""

from __future__ import annotations

from torchreg.neighbors.coverage import Coverage


def refusal(inliers: int, matches: int, near: Coverage) -> str:
    """Why not, or an empty text."""
    return ""
