"""The pages of the API reference, from the lists of public names in the code.

A name is public where ``torchreg.__all__`` or the ``__all__`` of a public package has it. Each is described once: as
``torchreg.NAME`` where it stands there, else in the package that it is defined in.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import torchreg as tr

# Public packages that torchreg.__all__ does not name, as their names are for those who look further
FURTHER = ("io", "report", "site", "solvers", "types")
INDEX = "index"  # the area of names that no package defines


class PublicName(NamedTuple):
    """A public name, where it is described."""

    path: str  # such as torchreg.nn.FPFH
    area: str  # the page: the first package of the module that defines it
    value: object

    @property
    def has_docstring(self) -> bool:
        """Whether it is a function or a class, and no constant."""
        return inspect.isroutine(self.value) or inspect.isclass(self.value)


def public_packages() -> tuple[str, ...]:
    """Names of the packages below ``torchreg`` whose ``__all__`` is public."""
    return tuple(sorted({*(name for name in tr.__all__ if isinstance(getattr(tr, name), ModuleType)), *FURTHER}))


def public_names() -> tuple[PublicName, ...]:
    """Every public function, class and constant once, by area and name."""
    names: dict[str, PublicName] = {}
    seen: set[int] = set()
    places = [("torchreg", tr), *((f"torchreg.{name}", _package(name)) for name in public_packages())]
    listed = [(path, module, name) for path, module in places for name in module.__all__]
    listed.sort(key=lambda entry: (entry[0] != "torchreg", not _defined_in(entry[0], getattr(entry[1], entry[2]))))
    for path, module, name in listed:
        for public in _described(path, module, name):
            if id(public.value) not in seen:
                seen.add(id(public.value))
                names[public.path] = public
    return tuple(sorted(names.values(), key=lambda public: (public.area, public.path.lower())))


def write_pages(folder: Path) -> None:
    """Write ``index.rst`` and a page for each area into a folder; pages that are the same stay as they are."""
    folder.mkdir(exist_ok=True)
    names = public_names()
    areas = sorted({public.area for public in names} - {INDEX})
    pages = {f"{area}.rst": _page(area, [public for public in names if public.area == area]) for area in areas}
    pages["index.rst"] = _index(areas, [public for public in names if public.area == INDEX])
    for old in folder.glob("*.rst"):
        if old.name not in pages:
            old.unlink()
    for name, text in pages.items():
        path = folder / name
        if not path.exists() or path.read_text() != text:
            path.write_text(text)


def _package(name: str) -> ModuleType:
    return importlib.import_module(f"torchreg.{name}")


def _area(path: str, module: ModuleType, name: str) -> str:
    """The package whose page describes a name: that which is named, or that which defines a name of ``torchreg``."""
    if path != "torchreg":
        return path.split(".")[1]
    value = getattr(module, name)
    defined = value if inspect.isclass(value) or inspect.isroutine(value) else type(value)
    words = getattr(defined, "__module__", "").split(".")
    return words[1] if words[0] == "torchreg" else INDEX


def _defined_in(path: str, value: object) -> bool:
    return getattr(value, "__module__", "").startswith(path)


def _described(path: str, module: ModuleType, name: str) -> Iterator[PublicName]:
    """The name itself, or those of a module that is one of a package's names (``reference.open3d``)."""
    value = getattr(module, name)
    if not isinstance(value, ModuleType):
        yield PublicName(f"{path}.{name}", _area(path, module, name), value)
    elif module is not tr:
        for inner in value.__all__:
            yield PublicName(f"{path}.{name}.{inner}", _area(path, module, name), getattr(value, inner))


def _summary(area: str) -> str:
    return (inspect.getdoc(_package(area)) or "").partition("\n")[0]


def _page(area: str, names: list[PublicName]) -> str:
    lines = [*_title(f"``torchreg.{area}``", "="), _summary(area), ""]
    lines += [f"* :py:obj:`{public.path.removeprefix('torchreg.')} <{public.path}>`{_said(public)}" for public in names]
    lines.append("")
    for public in names:
        lines += [*_title(public.path.removeprefix("torchreg."), "-"), *_description(public), ""]
    return "\n".join(lines)


def _title(text: str, line: str) -> list[str]:
    return [text, line * len(text), ""]


def _said(public: PublicName) -> str:
    """The first line of a docstring, after a colon."""
    return f": {(inspect.getdoc(public.value) or '').partition(chr(10))[0]}" if public.has_docstring else ": constant"


def _description(public: PublicName) -> list[str]:
    """What Sphinx makes the description of."""
    if inspect.isclass(public.value):
        return [f".. autoclass:: {public.path}", "   :members:", "   :show-inheritance:"]
    if public.has_docstring:
        return [f".. autofunction:: {public.path}"]
    kind = type(public.value)
    named = f":py:class:`{kind.__name__}`" if kind.__module__.startswith("torchreg") else f"``{kind.__name__}``"
    value = [] if kind.__module__.startswith("torchreg") else [f"   ``{public.value!r}``", ""]
    return [f".. py:data:: {public.path}", "", f"   A constant, {named}.", "", *value]


def _index(areas: list[str], names: list[PublicName]) -> str:
    lines = _title("API reference", "=")
    lines += ["Every public name, by the package that defines it. ``tr`` is ``torchreg``.", ""]
    lines += [f"* :doc:`torchreg.{area} <{area}>`: {_summary(area)}" for area in areas]
    lines += ["", ".. toctree::", "   :hidden:", "", *(f"   {area}" for area in areas), ""]
    for public in names:
        lines += [*_description(public), ""]
    return "\n".join(lines)
