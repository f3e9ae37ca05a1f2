"""What a file holds, as a table for a terminal."""

from __future__ import annotations

from rich.table import Table

from torchreg.io import CloudFile
from torchreg.registration.options import RegistrationOptions
from torchreg.report.options_rows import options_rows
from torchreg.report.text import meters, plain, two_columns


def cloud_table(file: CloudFile, spacing: float, options: RegistrationOptions | None, defect: str) -> Table:
    """A cloud's file, its size and scale, and the options that ``register`` would derive from it.

    Args:
        file: as ``read_cloud_report`` returns it.
        spacing: meters between neighboring points.
        options: derived for a pair of such clouds; ``None`` where nothing can be derived.
        defect: why the cloud cannot be registered, or an empty text.
    """
    table = two_columns()
    dropped = f" ({file.dropped_non_finite:,} with NaN or infinity dropped)" if file.dropped_non_finite else ""
    table.add_row("file", plain(file.path))
    table.add_row("format", plain(file.format))
    table.add_row("points", f"{file.points_in_file:,} in the file{dropped}")
    table.add_row("extent", " x ".join(f"{edge:.4g}" for edge in file.extent) + " m")
    table.add_row("origin", ", ".join(f"{value:.9g}" for value in file.cloud.origin[0].tolist()) + " m")
    table.add_row("colors", f"yes, {file.color_depth}" if file.has_colors else "no")
    table.add_row("normals", "yes" if file.has_normals else "no")
    table.add_row("viewpoint", plain(file.viewpoint_source))
    table.add_row("spacing", meters(spacing) + " (median distance to the fourth neighbor)")
    for note in file.notes:
        table.add_row("note", plain(note))
    if options is not None:
        table.add_row()
        table.add_row("default options", "for a pair of clouds like this one")
        for name, value in options_rows(options, colored=file.has_colors):
            table.add_row(name, plain(value))
    if defect:
        table.add_row("cannot be registered", plain(defect))
    return table
