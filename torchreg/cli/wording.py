"""Messages of the library in the words of the command line: ``--scan`` where Python has ``scan=``."""

from __future__ import annotations

import re

from torchreg.declaration import declared
from torchreg.settings import PairSettings

_ARGUMENT = re.compile(rf"""\b({"|".join(declared(PairSettings))})=(?:(["'])(.*?)\2)?(?=[\s,;:.)]|$)""")


def by_options(text: str) -> str:
    """The text with every argument of Python that is a setting named as the option that it is here.

    Example:
        >>> by_options("expected one scan, or scan= to choose one; units='file' makes them meters")
        'expected one scan, or --scan to choose one; --units file makes them meters'
    """
    return _ARGUMENT.sub(lambda found: f"--{found[1].replace('_', '-')}{f' {found[3]}' if found[3] else ''}", text)
