"""Readers of other packages: loaded with the first file that needs them, and kept from raising errors of their own."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from torchreg.errors import CloudFileError
from torchreg.io.checks import refuse


def package(path: Path, name: str, extra: str) -> Any:  # noqa: ANN401
    """The module ``name``.

    Raises:
        CloudFileError: it is not installed; the message says how to.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        refuse(path, f"the package {name}, for such files (pip install {extra})", "none of this name")


@contextmanager
def refusing(path: Path, expected: str) -> Iterator[None]:
    """Turn whatever a foreign reader raises into a ``CloudFileError``; a panic of Rust is no ``Exception``."""
    try:
        yield
    except (CloudFileError, KeyboardInterrupt, SystemExit, GeneratorExit):
        raise
    except BaseException as error:
        text = next(iter(str(error).splitlines()), "")
        refuse(path, expected, f"{type(error).__name__}: {text}"[:200])
