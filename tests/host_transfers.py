"""A watch on what a kernel must not do: read a value back to the host, or let a shape depend on values."""

from __future__ import annotations

from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode

_WAITS = ("_local_scalar_dense", "nonzero", "masked_select", "_unique2", "unique_consecutive", "equal", "item")


class HostTransfers(TorchDispatchMode):
    """Lists the operations run inside it that would make a GPU wait for the host.

    Attributes:
        operations: all that ran.
        transfers: those that read a value back, size a tensor by values, or copy between devices.
    """

    def __init__(self) -> None:
        super().__init__()
        self.operations: list[str] = []
        self.transfers: list[str] = []

    def __torch_dispatch__(
        self, func: Any, types: Any, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        """Note the operation, then run it."""
        name = func.overloadpacket.__name__
        self.operations.append(name)
        result = func(*args, **(kwargs or {}))
        indexed_by_mask = name in ("index", "index_put", "index_put_") and any(
            index is not None and index.dtype == torch.bool for index in args[1]
        )
        if name in _WAITS or indexed_by_mask or _changes_device(name, args, kwargs or {}):
            self.transfers.append(name)
        return result


def _changes_device(name: str, args: tuple[Any, ...], kwargs: dict[str, Any]) -> bool:
    if name == "copy_":
        changed: bool = args[0].device != args[1].device
        return changed
    asked = kwargs.get("device")
    return name == "_to_copy" and asked is not None and torch.device(asked) != args[0].device
