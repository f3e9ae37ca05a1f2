"""Batches of clouds with all that a cloud can have, and the augmentations under test."""

import pytest
import torch

import torchreg as tr
from torchreg import augment


def cloud_of(seed: int, count: int = 60, dtype: torch.dtype = torch.float32) -> tr.Clouds:
    """One cloud with colors, normals, an origin and a viewpoint."""
    draw = torch.Generator().manual_seed(seed)
    return tr.Clouds(
        points=4 * torch.rand(count, 3, generator=draw, dtype=dtype),
        colors=torch.rand(count, 3, generator=draw, dtype=dtype),
        normals=torch.nn.functional.normalize(torch.randn(count, 3, generator=draw, dtype=dtype), dim=1),
        origin=torch.tensor([[3.0, -2.0, 1.0 + seed]], dtype=torch.float64),
        viewpoint=torch.rand(1, 3, generator=draw, dtype=dtype),
    )


@pytest.fixture
def batch() -> tr.Clouds:
    """Three clouds, one of them empty."""
    return tr.Clouds.pack([cloud_of(0), cloud_of(1, 0), cloud_of(2, 90)])


MAKERS = {
    "motion": lambda **options: augment.RandomMotion(**options),
    "heading": lambda **options: augment.RandomMotion(axis="up", angle=30, **options),
    "plane": lambda **options: augment.RandomCrop(**options),
    "box": lambda **options: augment.RandomCrop(shape="box", **options),
    "sphere": lambda **options: augment.RandomCrop(shape="sphere", **options),
    "jitter": lambda **options: augment.Jitter(**options),
    "thin": lambda **options: augment.RandomThin(**options),
    "voxels": lambda **options: augment.RandomVoxels(voxel_size=(0.8, 1.6), **options),
    "light": lambda **options: augment.Illumination(hue=0.3, **options),
    "all": lambda **options: augment.Compose(
        augment.RandomMotion(),
        augment.RandomCrop(shape="box"),
        augment.RandomThin(),
        augment.Jitter(),
        augment.Illumination(),
        **options,
    ),
}


@pytest.fixture(params=sorted(MAKERS))
def make(request):
    """A function that makes one kind of augmentation."""
    return MAKERS[request.param]
