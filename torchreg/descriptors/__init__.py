"""Surroundings of every point: FPFH, PCFH, contrast, learned histograms and their relatives, and their fusion.

A new descriptor is a file with its record, and its name here.
"""

from torchreg.descriptors.contrast import Contrast
from torchreg.descriptors.descriptor import Descriptor
from torchreg.descriptors.fpfh import Fpfh
from torchreg.descriptors.learned import Learned
from torchreg.descriptors.pcfh import Pcfh
from torchreg.descriptors.pfh import Pfh
from torchreg.descriptors.pfhrgb import PfhRgb
from torchreg.descriptors.shape_context import ShapeContext
from torchreg.descriptors.shot import Cshot, Shot
from torchreg.descriptors.spin_images import SpinImages

_RECORDS: tuple[type[Descriptor], ...] = (
    Fpfh,
    Pcfh,
    Contrast,
    Learned,
    Pfh,
    PfhRgb,
    SpinImages,
    ShapeContext,
    Shot,
    Cshot,
)
DESCRIPTORS: dict[str, type[Descriptor]] = {record.name: record for record in _RECORDS}
"""The descriptors of this package by name."""
