"""Which classes ``torch.load`` may make of a file that is not trusted, as with ``weights_only=True``."""

from __future__ import annotations

from typing import TypeVar

import torch

AnyClass = TypeVar("AnyClass", bound=type)


def loadable(kind: AnyClass) -> AnyClass:
    """Let ``torch.load(..., weights_only=True)`` make objects of this class: data, whose making runs no code of a file.

    A decorator.
    """
    torch.serialization.add_safe_globals([kind])
    return kind
