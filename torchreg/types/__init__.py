"""The named types that the stages pass on: tensors with checks of their shapes, without computation."""

from torchreg.types.candidate import Candidate, Proposal, StageCounts
from torchreg.types.clouds import Clouds
from torchreg.types.correspondences import Correspondences, SoftCorrespondences
from torchreg.types.failure import Failure
from torchreg.types.features import Features
from torchreg.types.neighborhoods import Neighborhoods
from torchreg.types.result import HypothesisCounts, RegistrationResult
from torchreg.types.verification import Verification

__all__ = [
    "Candidate",
    "Clouds",
    "Correspondences",
    "Failure",
    "Features",
    "HypothesisCounts",
    "Neighborhoods",
    "Proposal",
    "RegistrationResult",
    "SoftCorrespondences",
    "StageCounts",
    "Verification",
]
