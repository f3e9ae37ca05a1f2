"""Poses of two clouds without descriptors: bases of four points, and sets that are congruent to them."""

from torchreg.congruent.options import Super4pcsOptions
from torchreg.congruent.search import search_pair

__all__ = ["Super4pcsOptions", "search_pair"]
