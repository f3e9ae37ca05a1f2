"""Every method for sites by name. A new one is one file and its name in ``_FILES``."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module

from torchreg.benchmark.site.method import SiteMethod
from torchreg.errors import expect

_FILES = ("open3d_multiway", "ours")

SITE_METHODS: dict[str, SiteMethod] = {
    method.name: method for file in _FILES for method in import_module(f"{__package__}.{file}").SITE_METHODS
}
"""In the order of the tables: peers first."""


def chosen_site_methods(names: Sequence[str] | None, *, quick: bool = False) -> tuple[SiteMethod, ...]:
    """Methods by name in the order of ``SITE_METHODS``; ``None`` takes all, or with ``quick`` those that are not slow.

    Raises:
        ValueError: a name that no method has, or none at all.
    """
    if names is None:
        return tuple(method for method in SITE_METHODS.values() if not (quick and method.slow))
    expect(len(names) > 0, "methods", "at least one", names)
    for name in names:
        expect(name in SITE_METHODS, "methods", "names out of " + ", ".join(SITE_METHODS), name)
    return tuple(method for name, method in SITE_METHODS.items() if name in names)
