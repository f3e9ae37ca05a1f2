"""A table of the scans of one file for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table

from torchreg.io.scan_heads import ScanHead
from torchreg.report.text import plain


def scans_table(path: str, heads: Sequence[ScanHead]) -> Table:
    """A row for each scan of a file: number, name, points, colors, pose, and where its scanner stood."""
    table = Table(title=plain(f"{path}: {len(heads)} scans"), title_justify="left")
    table.add_column("scan", justify="right")
    table.add_column("name")
    table.add_column("points", justify="right")
    for name in ("colors", "pose", "scanner"):
        table.add_column(name)
    for head in heads:
        scanner = "not known" if head.scanner is None else ", ".join(f"{x:.3f}" for x in head.scanner.tolist())
        table.add_row(
            str(head.number),
            plain(head.name or ""),
            "not said" if head.points is None else f"{head.points:,}",
            "yes" if head.has_colors else "no",
            "no" if head.pose is None else "yes",
            scanner,
        )
    return table
