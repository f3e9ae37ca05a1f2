"""Nearest neighbors within a radius, and between two point sets."""

from torchreg.neighborhoods.point_index import Nearest, nearest
from torchreg.neighborhoods.search import neighbors

__all__ = ["Nearest", "nearest", "neighbors"]
