"""Random changes of clouds for training: motion, crop, noise, density and light, each from its own generator.

Every augmentation is a module: ``augment(clouds)`` gives clouds, ``augment.tracked(clouds)`` also the motion that it
made. ``Compose`` runs several, ``AugmentPair`` changes both clouds of a pair and keeps its true motion true.

Example:
    >>> import torch, torchreg as tr
    >>> from torchreg import augment
    >>> both = augment.Compose(augment.RandomMotion(), augment.RandomCrop(), augment.Jitter(), augment.Illumination())
    >>> pair = tr.datasets.mall(seed=1, angular_step=4.0)
    >>> changed = augment.AugmentPair(both, generator=torch.Generator().manual_seed(0))(pair)
    >>> len(changed.source.points) < len(pair.source.points)
    True
"""

from torchreg.augment.augmentation import Augmentation, Tracked
from torchreg.augment.compose import Compose
from torchreg.augment.crop import RandomCrop
from torchreg.augment.density import RandomThin, RandomVoxels
from torchreg.augment.illumination import Illumination
from torchreg.augment.jitter import Jitter
from torchreg.augment.motion import RandomMotion
from torchreg.augment.pair import AugmentPair
from torchreg.augment.tone import shift_hue

__all__ = [
    "AugmentPair",
    "Augmentation",
    "Compose",
    "Illumination",
    "Jitter",
    "RandomCrop",
    "RandomMotion",
    "RandomThin",
    "RandomVoxels",
    "Tracked",
    "shift_hue",
]
