"""Text of one point a line under a header that names the columns; every number in as few digits as it takes.

XYZ, TXT and ASC separate by blanks and keep the header in comments, which numpy and most programs skip. CSV has commas
and its names in the first line, as tables have, and nothing else.
"""

from __future__ import annotations

from typing import Any, BinaryIO

import numpy as np
import torch

from torchreg.io.viewpoint_line import viewpoint_line
from torchreg.io.written import color_levels, global_points, needs_doubles, normals_of
from torchreg.types import Clouds


def write_xyz(file: BinaryIO, cloud: Clouds, dtype: torch.dtype) -> None:
    """Write one cloud, the header in comments; ``write_cloud`` says what is kept."""
    table = _table(cloud, dtype)
    file.write(f"# {viewpoint_line(cloud)}\n# {' '.join(table.column_names)}\n".encode("ascii"))
    _write(file, table, " ")


def write_csv(file: BinaryIO, cloud: Clouds, dtype: torch.dtype) -> None:
    """Write one cloud as a table; ``write_cloud`` says what is kept."""
    table = _table(cloud, dtype)
    file.write(f"{','.join(table.column_names)}\n".encode("ascii"))
    _write(file, table, ",")


def _table(cloud: Clouds, dtype: torch.dtype) -> Any:  # noqa: ANN401
    import pyarrow

    points, normals, levels = global_points(cloud), normals_of(cloud), color_levels(cloud, 255)
    number = np.float64 if needs_doubles(cloud, points, dtype) else np.float32
    groups = (
        (("x", "y", "z"), points, number),
        (("red", "green", "blue"), levels, np.uint8),
        (("nx", "ny", "nz"), normals, np.float32),
    )
    return pyarrow.table(
        {
            name: np.ascontiguousarray(values[:, i], dtype=kind)
            for names, values, kind in groups
            if values is not None
            for i, name in enumerate(names)
        }
    )


def _write(file: BinaryIO, table: Any, delimiter: str) -> None:  # noqa: ANN401
    import pyarrow.csv

    options = pyarrow.csv.WriteOptions(include_header=False, delimiter=delimiter, quoting_style="none")
    pyarrow.csv.write_csv(table, file, options)
