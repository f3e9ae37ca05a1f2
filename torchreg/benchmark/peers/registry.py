"""Every method by name, and what is left out, with the reason. A new peer is one file and its name in ``_FILES``."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module

from torchreg.benchmark.peers.method import Method
from torchreg.errors import expect

_FILES = ("open3d_ransac", "open3d_fgr", "kiss", "graph_cut", "magsac", "ours")

METHODS: dict[str, Method] = {
    method.name: method for file in _FILES for method in import_module(f"{__package__}.{file}").METHODS
}
"""In the order of the tables: peers first."""

NOT_HERE: dict[str, str] = {
    "TEASER++": "PyPI has no package of it.",
    "Go-ICP": "PyPI has its source alone (py-goicp), no wheel.",
    "SDRSAC": "PyPI lists it (sdrsac) without a file that can be installed.",
    "probreg": "PyPI has its source alone, no wheel; its methods also need a first guess.",
    "GRIP": "gripcd needs pytorch3d, of which PyPI has no wheel.",
    "CliReg": "its wheel (clireg 1.0.4) logs to standard output, and on scans of this kind, with these features and "
    "thresholds, it ends with too small a graph of matches.",
    "Occulus": "its FPFH and its RANSAC are loops in Python that never end early, and it takes no seed.",
}
"""What a reader might miss beside these, and why it is not there."""


def chosen_methods(names: Sequence[str] | None, *, quick: bool = False) -> tuple[Method, ...]:
    """Methods by name in the order of ``METHODS``; ``None`` takes all, or with ``quick`` those that are not slow.

    Raises:
        ValueError: a name that no method has, or none at all.
    """
    if names is None:
        return tuple(method for method in METHODS.values() if not (quick and method.slow))
    expect(len(names) > 0, "methods", "at least one", names)
    for name in names:
        expect(name in METHODS, "methods", "names out of " + ", ".join(METHODS), name)
    return tuple(method for name, method in METHODS.items() if name in names)
