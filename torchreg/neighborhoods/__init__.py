"""Nearest neighbors within a radius, and between two point sets."""

from torchreg.neighborhoods.nearest import Nearest, nearest
from torchreg.neighborhoods.search import neighbors

__all__ = ["Nearest", "nearest", "neighbors"]
