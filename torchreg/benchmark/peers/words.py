"""How methods were run and which are missing, as Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from torchreg.benchmark.peers.method import Method
from torchreg.benchmark.peers.registry import NOT_HERE


def how_and_gaps(methods: Sequence[Method], gaps: Mapping[str, str]) -> list[str]:
    """Two sections: a line for every method, and one for each that could not run or is not to be had.

    Args:
        methods: those asked for.
        gaps: why some of them could not run, by name.
    """
    said = [f"- {method.title} (`{method.name}`): {method.statement}" for method in methods]
    missing = [f"- {method.title}: {gaps[method.name]}" for method in methods if method.name in gaps]
    missing += [f"- {name}: {why}" for name, why in NOT_HERE.items()]
    return ["## How each was run", "\n".join(said), "## What is missing", "\n".join(missing)]


def nothing(method: Method, gaps: Mapping[str, str], width: int) -> list[str]:
    """The cells of a method that has no rows."""
    return ["not installed" if method.name in gaps else "not run", *["-"] * (width - 1)]
