"""Random changes of clouds for training: motion, crop, noise, density and light, each from its own generator.

Every augmentation is a module: ``module(clouds)`` returns changed clouds, ``module.tracked(clouds)`` also their motion.
``Compose`` runs several, ``AugmentPair`` changes both clouds of a pair and keeps its true motion true.

Example:
    >>> import torch, torchreg as tr
    >>> from torchreg import augment
    >>> both = augment.Compose(augment.RandomMotion(), augment.RandomCrop(), augment.Jitter(), augment.Illumination())
    >>> pair = tr.datasets.mall(seed=1, angular_step=4.0)
    >>> changed = augment.AugmentPair(both, generator=torch.Generator().manual_seed(0))(pair)
    >>> len(changed.source.points) < len(pair.source.points)
    True
"""

from torchreg.augment.augmentation import Augmentation, AugmentPair, Compose, Tracked
from torchreg.augment.illumination import Illumination, shift_hue
from torchreg.augment.motion import Jitter, RandomMotion
from torchreg.augment.selections import RandomCrop, RandomThin, RandomVoxels

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
