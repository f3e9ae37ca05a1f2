"""The one form of an error message: the argument's name, what was expected and what came."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def refuses(name: str, *parts: str) -> Iterator[None]:
    """Expect a ``ValueError`` about the argument ``name`` whose message holds all ``parts``."""
    with pytest.raises(ValueError, match=rf"^{re.escape(name)}: expected ") as caught:
        yield
    message = str(caught.value)
    assert re.match(rf"^{re.escape(name)}: expected .+, got .+", message, re.DOTALL), message
    for part in parts:
        assert part in message, message
