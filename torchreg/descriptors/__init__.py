"""Surroundings of every point: FPFH, PCFH, contrast and learned histograms, and their fusion.

A new descriptor is a file with its record, and its name here.
"""

from torchreg.descriptors.contrast import Contrast
from torchreg.descriptors.descriptor import Descriptor
from torchreg.descriptors.fpfh import Fpfh
from torchreg.descriptors.learned import Learned
from torchreg.descriptors.pcfh import Pcfh
from torchreg.descriptors.shot import Cshot, Shot

DESCRIPTORS: dict[str, type[Descriptor]] = {
    record.name: record for record in (Fpfh, Pcfh, Contrast, Learned, Shot, Cshot)
}
"""The descriptors of this package by name."""
