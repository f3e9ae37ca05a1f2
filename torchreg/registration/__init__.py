"""The pipeline as one function, its presets, and the scale it derives from the clouds."""

from torchreg.registration.presets import PAPER
from torchreg.registration.register import register
from torchreg.registration.scale import derive_options, spacing

__all__ = ["PAPER", "derive_options", "register", "spacing"]
