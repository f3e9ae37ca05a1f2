"""What describes a point: FPFH (geometry), PCFH and contrast (color), and their fusion."""

from torchreg.descriptors.contrast import contrast
from torchreg.descriptors.fpfh import fpfh
from torchreg.descriptors.fuse import fuse
from torchreg.descriptors.pcfh import pcfh

__all__ = ["contrast", "fpfh", "fuse", "pcfh"]
