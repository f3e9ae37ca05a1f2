"""Options by name."""

from __future__ import annotations

from dataclasses import replace

from torchreg.descriptors.fpfh import Fpfh
from torchreg.descriptors.learned import Learned, shipped_numbers
from torchreg.registration.options import RegistrationOptions

PAPER = RegistrationOptions()
"""The paper's parameters (section 4.1), in meters, for scans of buildings: normals 2 m / 30, FPFH 5 m / 100,
PCFH of equalized hue 2 m / 11 bins, mutual matches, edge similarity 0.9, 0.2 m, 600,000 hypotheses at
confidence 0.999. Clouds are not downsampled: the paper draws 10,000 points first (``random_downsample``)."""

_WEIGHT, _ROOT = shipped_numbers()

LEARNED = replace(PAPER, descriptors=(Fpfh(radius=5.0), Learned(radius=2.0)), weights=(1.0, _WEIGHT), root=_ROOT)
"""The paper's procedure with features whose color block was trained on colored scans (``python bench/sensitivity.py
ship``): bins, channel weights, the weight of every neighbor, the block's weight and the roots of histograms. On scenes
that training never saw such features beat the paper's fixed rule (README). Lengths are the paper's, in meters; for
points of spacing s take ``LEARNED.scaled(s)`` with an inlier threshold of 1.5 s."""

PRESETS = {"paper": PAPER, "learned": LEARNED}
"""Every preset by its name."""
