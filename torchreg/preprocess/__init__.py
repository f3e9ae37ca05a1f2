"""Downsampling, and normals that face the scanner."""

from torchreg.preprocess.downsample import (
    farthest_point_downsample,
    random_downsample,
    voxel_downsample,
)
from torchreg.preprocess.normals import estimate_normals

__all__ = ["estimate_normals", "farthest_point_downsample", "random_downsample", "voxel_downsample"]
