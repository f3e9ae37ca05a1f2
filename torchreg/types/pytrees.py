"""Records as nodes of PyTorch's pytrees: their leaves are their tensors, for ``tree_map``, ``vmap``, ``torch.export``.

Numbers and texts belong to the structure, as does which fields are ``None``.
"""

from __future__ import annotations

import json
from functools import partial
from typing import Any, NamedTuple

from torch import Tensor
from torch.utils import _pytree as pytree

from torchreg.types.held import Offsets, PerItem, PerRow, Times, Timings, held_by


class Hollow(NamedTuple):
    """The structure of a field that holds tensors among other things.

    Attributes:
        spec: of the value as a pytree.
        leaves: its leaves, ``None`` in place of tensors.
        places: of its tensors among the leaves.
    """

    spec: pytree.TreeSpec
    leaves: tuple[Any, ...]
    places: tuple[int, ...]


def register_pytree(kind: type) -> None:
    """Make a dataclass whose fields are declared (``held``) a node of pytrees."""
    pytree.register_pytree_node(
        kind,
        _flatten,
        partial(_unflatten, kind),
        serialized_type_name=f"{kind.__module__}.{kind.__qualname__}",
        to_dumpable_context=json.dumps,
        from_dumpable_context=lambda text: _tuples(json.loads(text)),
        flatten_with_keys_fn=_flatten_with_keys,
    )


def _flatten_with_keys(record: Any) -> tuple[list[tuple[Any, Any]], tuple[Any, ...]]:  # noqa: ANN401
    children: list[tuple[Any, Any]] = []
    structure: list[Any] = []
    for name, kind in held_by(type(record)).items():
        value = getattr(record, name)
        if isinstance(kind, (PerRow, PerItem, Offsets)):
            children += [(pytree.GetAttrKey(name), value)] if value is not None else []
            structure.append(value is not None)
        elif isinstance(kind, Times):
            structure.append(Timings(value))
        else:
            tensors, rest = _split(value)
            children += [(pytree.GetAttrKey(name + path), tensor) for path, tensor in tensors]
            structure.append(rest)
    return children, tuple(structure)


def _flatten(record: Any) -> tuple[list[Any], tuple[Any, ...]]:  # noqa: ANN401
    children, structure = _flatten_with_keys(record)
    return [child for _, child in children], structure


def _unflatten(kind: type, children: Any, structure: tuple[Any, ...]) -> Any:  # noqa: ANN401
    """The record without its checks: leaves may be anything, such as what a graph is captured with."""
    record: Any = object.__new__(kind)
    left = iter(children)
    for (name, held), rest in zip(held_by(kind).items(), structure, strict=True):
        if isinstance(held, (PerRow, PerItem, Offsets)):
            value = next(left) if rest else None
            if isinstance(held, Offsets) and isinstance(value, Tensor) and value.device.type not in ("cpu", "meta"):
                value = value.cpu()  # where a map has moved all tensors
        elif isinstance(rest, Hollow):
            leaves = list(rest.leaves)
            for place in rest.places:
                leaves[place] = next(left)
            value = pytree.tree_unflatten(leaves, rest.spec)
        else:
            value = tuple(rest) if isinstance(rest, Timings) else rest
        object.__setattr__(record, name, value)
    return record


def _split(value: Any) -> tuple[list[tuple[str, Tensor]], Any]:  # noqa: ANN401
    """The tensors of a value, each with its place as a text, and the value or what is left of it."""
    named, spec = pytree.tree_flatten_with_path(value)
    places = tuple(place for place, (_, leaf) in enumerate(named) if isinstance(leaf, Tensor))
    if not places:
        return [], value
    rest = tuple(None if isinstance(leaf, Tensor) else leaf for _, leaf in named)
    return [(pytree.keystr(named[place][0]), named[place][1]) for place in places], Hollow(spec, rest, places)


def _tuples(value: Any) -> Any:  # noqa: ANN401
    """The value with tuples in place of lists, all the way down."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
