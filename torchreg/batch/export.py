"""The table of a batch as CSV, JSON and Parquet: the same bytes whenever the same pairs are registered.

Times are no part of it, since no two runs take the same; they are in ``times.csv``.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torchreg.batch.rows import COLUMNS
from torchreg.io.atomic import atomic_write

Line = dict[str, Any]


def export(folder: Path, lines: Sequence[Line], seconds: Sequence[Mapping[str, float]]) -> None:
    """Write ``results.csv``, ``.json`` and ``.parquet``, and ``times.csv``, each in full or not at all.

    Args:
        folder: of the batch.
        lines: of all pairs, in their order.
        seconds: of their stages.

    Raises:
        OSError: one cannot be written.
    """
    extra = list(dict.fromkeys(name for line in lines for name in line if name not in COLUMNS))
    names = [*COLUMNS, *extra]
    stages = list(dict.fromkeys(stage for one in seconds for stage in one))
    times = [{"name": line["name"], **one} for line, one in zip(lines, seconds, strict=True)]
    _write(folder / "results.csv", _csv(names, lines).encode())
    _write(folder / "results.json", (json.dumps(list(lines), indent=1, allow_nan=False) + "\n").encode())
    _write(folder / "results.parquet", _parquet(names, lines))
    _write(folder / "times.csv", _csv(["name", *stages], times).encode())


def _write(path: Path, content: bytes) -> None:
    with atomic_write(path) as file:
        file.write(content)


def _csv(names: Sequence[str], lines: Sequence[Line]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([_cell(line.get(name)) for name in names] for line in lines)
    return text.getvalue()


def _cell(value: Any) -> Any:  # noqa: ANN401
    if isinstance(value, bool):
        return str(value).lower()
    return " ".join(map(repr, value)) if isinstance(value, list) else value


def _parquet(names: Sequence[str], lines: Sequence[Line]) -> bytes:
    import pyarrow
    from pyarrow import parquet

    kinds = {
        "text": pyarrow.string(),
        "bool": pyarrow.bool_(),
        "number": pyarrow.float64(),
        "count": pyarrow.int64(),
        "numbers": pyarrow.list_(pyarrow.float64()),
    }
    schema = pyarrow.schema([(name, kinds[COLUMNS.get(name, "text")]) for name in names])
    columns = {name: [line.get(name) for line in lines] for name in names}
    content = io.BytesIO()
    parquet.write_table(pyarrow.table(columns, schema=schema), content)
    return content.getvalue()
