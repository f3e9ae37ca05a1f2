"""Described clouds on disk, named by their content and by all that describing them depends on."""

from __future__ import annotations

import hashlib
import io
import json
from importlib import metadata
from pathlib import Path
from typing import Any

import torch

from torchreg.io.atomic import atomic_write
from torchreg.io.result_json import plain_data
from torchreg.registration.described import DescribedClouds, Description
from torchreg.registration.inspect import CloudFacts
from torchreg.types import Clouds, Failure, Features
from torchreg.version import __version__

_FORMAT = 3
_CHECKSUM_BYTES = 16  # before the content: a byte that changed on the disk would change results without a trace


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
    cloud = described.cloud
    content = {
        "points": cloud.points,
        "colors": cloud.colors,
        "normals": cloud.normals,
        "origin": cloud.origin,
        "viewpoint": cloud.viewpoint,
        "features": [
            {"values": item.values, "valid": item.valid, "blocks": [list(block) for block in item.blocks]}
            for item in described.features
        ],
        "spacing": list(described.spacing),
        "facts": [_plain(facts) for facts in described.facts],
    }
    buffer = io.BytesIO()
    torch.save(content, buffer)
    with atomic_write(path, durable=False) as file:  # the checksum shows what a power cut damaged
        file.write(_checksum(buffer.getvalue()))
        file.write(buffer.getvalue())


def read_described(path: Path, description: Description) -> DescribedClouds | None:
    """Read one cloud that was described so.

    ``None`` where the file is missing or damaged, so that it is to be made again.
    """
    try:
        content = path.read_bytes()
    except OSError:
        return None
    checksum, body = content[:_CHECKSUM_BYTES], content[_CHECKSUM_BYTES:]
    if _checksum(body) != checksum:
        return None
    return _described(torch.load(io.BytesIO(body), map_location="cpu", weights_only=True), description)


def _plain(facts: CloudFacts) -> list[Any]:
    """The facts of one cloud without types of this package."""
    defect = facts.defect
    return list(facts._replace(defect=None if defect is None else (defect.kind, defect.text, dict(defect.figures))))  # type: ignore[arg-type]


def _checksum(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=_CHECKSUM_BYTES).digest()


def _described(content: dict[str, Any], description: Description) -> DescribedClouds:
    cloud = Clouds(**{name: content[name] for name in ("points", "colors", "normals", "origin", "viewpoint")})
    features = tuple(
        Features(
            values=item["values"],
            offsets=cloud.offsets,
            blocks=tuple((str(block), int(size)) for block, size in item["blocks"]),
            valid=item["valid"],
        )
        for item in content["features"]
    )
    facts = []
    for points, extent, failure, colors, faced in content["facts"]:
        defect = None if failure is None else Failure(*failure)
        facts.append(CloudFacts(points, extent, defect, None if colors is None else tuple(colors), faced))
    return DescribedClouds(cloud, features, (description,), tuple(content["spacing"]), tuple(facts))
