"""What PyTorch's default collate function says of the types here: the function that joins them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NoReturn, TypeVar

from torch.utils.data._utils.collate import default_collate_fn_map

AnyClass = TypeVar("AnyClass", bound=type)


def collated_by(function: str) -> Callable[[AnyClass], AnyClass]:
    """Let a ``DataLoader`` without ``collate_fn`` say which function takes its place for objects of a class.

    Without one, ``default_collate`` is asked to stack what cannot be stacked. A decorator.
    """

    def refuse(batch: list[Any], **_: Any) -> NoReturn:  # noqa: ANN401
        kind = type(batch[0]).__name__
        raise TypeError(
            f"collate_fn: expected {function}, which joins any number of {kind}, as in "
            f"DataLoader(..., collate_fn={function}); got PyTorch's default_collate"
        )

    def decorate(kind: AnyClass) -> AnyClass:
        default_collate_fn_map[kind] = refuse
        return kind

    return decorate
