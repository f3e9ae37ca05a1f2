"""Options by name."""

from __future__ import annotations

from torchreg.types import RegistrationOptions

PAPER = RegistrationOptions()
"""The paper's parameters (section 4.1), in meters, for scans of buildings: normals 2 m / 30, FPFH 5 m / 100,
PCFH of equalized hue 2 m / 11 bins, mutual matches, edge similarity 0.9, 0.2 m, 600,000 hypotheses at
confidence 0.999. Clouds are taken as they come: the paper draws 10,000 points first (``random_downsample``)."""
