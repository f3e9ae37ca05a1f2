"""Which clouds of a batch are the same, to the bit, so that each is measured and described once."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import torch
from torch import Tensor

from torchreg.types import Clouds
from torchreg.types.held import Offsets, held_by

_PRIME = 1_000_003


def same_clouds(batches: Sequence[Clouds]) -> list[list[int]]:
    """Number the clouds of several batches on one device so that equal ones, and only these, have the same number.

    The number of a cloud is the place of the first equal one, counted through all batches.
    """
    clouds = [cloud for batch in batches for cloud in batch.unpack()]
    if not clouds:
        return [[] for _ in batches]
    prints = torch.stack([_fingerprint(cloud) for cloud in clouds]).tolist()
    first: dict[tuple[int, int], list[int]] = {}
    numbers: list[int] = []
    for place, (cloud, print_) in enumerate(zip(clouds, prints, strict=True)):
        alike = first.setdefault((len(cloud.points), print_), [])
        number = next((other for other in alike if _equal(cloud, clouds[other])), place)
        if number == place:
            alike.append(place)
        numbers.append(number)
    split = iter(numbers)
    return [[next(split) for _ in range(len(batch))] for batch in batches]


def digest_of(cloud: Clouds) -> str:
    """Hexadecimal digits that name the content of a cloud: all its tensors, and whether its viewpoint is a guess."""
    digest = hashlib.blake2b(digest_size=16)
    for part in _parts(cloud):
        digest.update(b"none" if part is None else _bytes(part))
    return digest.hexdigest()


def _parts(cloud: Clouds) -> tuple[Tensor | None, ...]:
    held = held_by(Clouds).items()
    return tuple(getattr(cloud, name) for name, kind in held if not isinstance(kind, Offsets))


def _fingerprint(cloud: Clouds) -> Tensor:
    """A whole number () int64 that equal clouds share; sums of whole numbers have no order."""
    total = torch.zeros((), dtype=torch.int64, device=cloud.device)
    for part in _parts(cloud):
        total = total * _PRIME
        if part is not None and part.numel() > 0:
            whole = _bits(part).flatten().to(torch.int64)
            total = total + whole.sum() * _PRIME + (whole * torch.arange(1, len(whole) + 1, device=whole.device)).sum()
    return total


def _equal(one: Clouds, other: Clouds) -> bool:
    """Whether two clouds have the same bits: NaN equals NaN, and 0.0 is not -0.0."""
    return all(
        (a is None) == (b is None)
        and (a is None or b is None or (a.dtype == b.dtype and torch.equal(*map(_bits, (a, b)))))
        for a, b in zip(_parts(one), _parts(other), strict=True)
    )


def _bits(part: Tensor) -> Tensor:
    return part.contiguous().view({1: torch.int8, 2: torch.int16, 4: torch.int32, 8: torch.int64}[part.element_size()])


def _bytes(part: Tensor) -> bytes:
    array = part.cpu().contiguous().numpy()
    return f"{array.dtype} {array.shape}".encode() + array.tobytes()
