"""Nearest neighbors within a radius, and between two point sets."""

from torchreg.neighbors.nearest import Nearest, nearest
from torchreg.neighbors.search import neighbors

__all__ = ["Nearest", "nearest", "neighbors"]
