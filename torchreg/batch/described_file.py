"""Described clouds on disk, named by their content and by all that describing them depends on."""

from __future__ import annotations

import hashlib
import io
import json
from importlib import metadata
from pathlib import Path

import torch

from torchreg.batch.checked_file import read_checked, write_checked
from torchreg.io.result_json import plain_data
from torchreg.registration.described import DescribedClouds, Description
from torchreg.version import __version__

_FORMAT = 9


def described_name(digest: str, description: Description, device: str) -> str:
    """The file's name for a cloud of this digest, described so on a device."""
    made = {"format": _FORMAT, "device": device, **computing_versions()}
    key = json.dumps({**made, "cloud": digest, "description": plain_data(description)})
    return f"{hashlib.blake2b(key.encode(), digest_size=16).hexdigest()}.pt"


def computing_versions() -> dict[str, str]:
    """Versions of what computes: another one may round otherwise."""
    return {"torchreg": __version__, **{name: metadata.version(name) for name in ("torch", "open3d")}}


def write_described(path: Path, described: DescribedClouds) -> None:
    """Write one described cloud, in full or not at all.

    Raises:
        OSError: it cannot be written.
    """
    rows = described.cloud, described.features, described.keypoints
    content = (*rows, described.spacing, described.facts, described.surfels)
    buffer = io.BytesIO()
    torch.save(content, buffer)
    write_checked(path, buffer.getvalue())


def read_described(path: Path, description: Description) -> DescribedClouds | None:
    """Read one cloud that was described so.

    ``None`` where the file is missing or damaged, or was written under another name and so is another's description, so
    that it is to be made again.
    """
    body = read_checked(path)
    if body is None:
        return None
    content = torch.load(io.BytesIO(body), map_location="cpu", weights_only=True)
    cloud, features, keypoints, spacing, facts, surfels = content
    return DescribedClouds(cloud, features, (description,), spacing, facts, surfels, keypoints=keypoints)
