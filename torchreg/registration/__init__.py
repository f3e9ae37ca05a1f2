"""The pipeline as one function, its two halves, its presets, and the scale it derives from the clouds."""

from torchreg.registration.described import DescribedClouds
from torchreg.registration.describing import describe_clouds
from torchreg.registration.match_and_solve import register_described
from torchreg.registration.presets import LEARNED, PAPER
from torchreg.registration.scale import derive_options, spacing

__all__ = [
    "LEARNED",
    "PAPER",
    "DescribedClouds",
    "derive_options",
    "describe_clouds",
    "register_described",
    "spacing",
]
