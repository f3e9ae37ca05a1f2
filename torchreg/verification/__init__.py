"""Which candidate pose is right, if any: asked of the clouds themselves, answered with a probability."""

from torchreg.verification.care import Care, Lengths
from torchreg.verification.collect import Proposed

__all__ = ["Care", "Lengths", "Proposed"]
