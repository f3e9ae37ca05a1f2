"""The descriptors that the library has, by name: a new one is a file with its record, and its name here."""

from __future__ import annotations

from torchreg.descriptors.contrast import Contrast
from torchreg.descriptors.descriptor import Descriptor
from torchreg.descriptors.fpfh import Fpfh
from torchreg.descriptors.learned import Learned
from torchreg.descriptors.pcfh import Pcfh

DESCRIPTORS: dict[str, type[Descriptor]] = {record.name: record for record in (Fpfh, Pcfh, Contrast, Learned)}
"""Every descriptor by its name."""
