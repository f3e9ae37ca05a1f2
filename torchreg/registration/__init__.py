"""The pipeline as one function, its two halves, its options and presets, and the scale it derives from the clouds."""

from torchreg.registration.describe import describe_clouds
from torchreg.registration.described import DescribedClouds
from torchreg.registration.options import LEARNED, PAPER, RegistrationOptions
from torchreg.registration.register import register_described
from torchreg.registration.spacing import derive_options, options_for

__all__ = [
    "LEARNED",
    "PAPER",
    "DescribedClouds",
    "RegistrationOptions",
    "derive_options",
    "describe_clouds",
    "options_for",
    "register_described",
]
