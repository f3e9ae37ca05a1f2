"""A color block whose bins, channel weights and say of neighbors were trained (``torchreg.learning``)."""

from torchreg.descriptors.learned.model import LearnedColor
from torchreg.descriptors.learned.shipped import load_weights, save_weights, shipped_color

__all__ = ["LearnedColor", "load_weights", "save_weights", "shipped_color"]
