"""A scan in a frame of its own with the pose of that frame, as E57 and PTX hold scans."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import expect_in_words
from torchreg.geometry.se3 import compose, inverse, rigid, transform
from torchreg.io.fields import PointFields
from torchreg.io.transform_text import checked_rigid
from torchreg.types import Clouds


class PosedScan(NamedTuple):
    """One scan of a file of scans, on the CPU in float64.

    Example:
        >>> import torch, torchreg as tr
        >>> scan = tr.io.posed_scan(tr.Clouds(torch.rand(10, 3)), torch.eye(4, dtype=torch.float64), name="hall")
        >>> scan.name, scan.T_file_scan.shape
        ('hall', torch.Size([4, 4]))
    """

    cloud: Clouds
    """In the scan's own frame, its origin zero."""

    T_file_scan: Tensor
    """(4, 4) float64, rigid, meters: from that frame to the frame of the file."""

    name: str
    fields: PointFields

    def in_file(self) -> Clouds:
        """The cloud in the frame of the file."""
        return transform(self.cloud, self.T_file_scan)


@entry
def posed_scan(
    cloud: Clouds,
    T_world_file: Tensor,
    *,
    pose: Tensor | None = None,
    name: str = "scan",
    fields: PointFields | None = None,
) -> PosedScan:
    """Give a scan its place in the world.

    The frame of the scan is the one that its file had for it, or else has its zero where the scanner stands, or where
    the cloud has its origin if nobody knows.

    Args:
        cloud: a batch of one, as it was read.
        T_world_file: (4, 4) rigid, meters: from the frame of the file that was read to that of the file to write.
        pose: (4, 4) ``T_file_scan`` of the file that was read, which the points have applied (``CloudFile.pose``).
        name: of the scan.
        fields: of its points.

    Raises:
        ValueError: a batch of several clouds, a matrix that is not rigid, fields of another number of points.

    Example:
        >>> import torch, torchreg as tr
        >>> scan = tr.io.posed_scan(tr.Clouds(torch.rand(10, 3)), torch.eye(4, dtype=torch.float64), name="hall")
        >>> tr.io.write_scans("hall.ptx", [scan])
    """
    expect_in_words(len(cloud) == 1, "cloud", "a batch of one (cloud[b] picks one)", f"{len(cloud)} clouds")
    wide = cloud.detach().to(device="cpu", dtype=torch.float64)
    to_world = torch.from_numpy(checked_rigid(T_world_file, "T_world_file"))
    own = _own_frame(wide) if pose is None else torch.from_numpy(checked_rigid(pose, "pose"))
    local = transform(wide, inverse(own))
    shift = local.origin[0]
    based = Clouds(
        points=local.points + shift,
        colors=local.colors,
        normals=local.normals,
        viewpoint=None if local.viewpoint is None else local.viewpoint + shift,
        viewpoint_assumed=local.viewpoint_assumed,
    )
    kept = PointFields() if fields is None else fields.checked(len(wide.points))
    return PosedScan(based, compose(to_world, own), name, kept)


def _own_frame(cloud: Clouds) -> Tensor:
    """``T_file_scan`` (4, 4) of a scan whose file has none: the axes of the file about the scanner."""
    zero = cloud.origin[0]
    if cloud.viewpoint is not None and bool(cloud.viewpoint.isfinite().all()):
        zero = zero + cloud.viewpoint[0]
    return rigid(torch.eye(3, dtype=torch.float64), zero)
