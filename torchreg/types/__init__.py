"""The named types that flow between the stages: they hold tensors and check them, they compute nothing."""

from torchreg.types.clouds import Clouds
from torchreg.types.correspondences import Correspondences
from torchreg.types.features import Features
from torchreg.types.neighborhoods import Neighborhoods
from torchreg.types.options import RansacOptions, RegistrationOptions
from torchreg.types.result import HypothesisCounts, RegistrationResult

__all__ = [
    "Clouds",
    "Correspondences",
    "Features",
    "HypothesisCounts",
    "Neighborhoods",
    "RansacOptions",
    "RegistrationOptions",
    "RegistrationResult",
]
