"""Numbers and names as a table shows them."""

from __future__ import annotations

from rich.table import Table
from rich.text import Text


def two_columns() -> Table:
    """An empty table of names and values, without lines; long values are folded, never cut."""
    table = Table.grid(padding=(0, 2))
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    return table


def plain(text: str) -> Text:
    """Text from outside (a path, a message) as it is: no markup, and nothing that would steer a terminal."""
    return Text(legible(text))


def legible(text: str) -> str:
    r"""The text with what cannot be printed, such as an escape or a stray byte of a file name, as ``\x1b``."""
    return "".join(
        mark if mark.isprintable() or mark == "\n" else mark.encode("unicode_escape").decode() for mark in text
    )


def meters(value: float) -> str:
    """Such as ``0.3679 m``: four digits that count."""
    return f"{value:.4g} m"


def share(part: int, whole: int) -> str:
    """Such as ``1,234 of 5,000 (25 %)``."""
    return f"{part:,} of {whole:,} ({100 * part / max(whole, 1):.3g} %)"
