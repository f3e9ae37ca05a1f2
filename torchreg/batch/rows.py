"""The table of a batch: its columns, the row of one pair, and the files that it is written to.

The files have the same bytes whenever the same pairs are registered; times, which no two runs share, are in
``times.csv`` alone.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from torchreg.batch.pairs import Pair
from torchreg.io import result_to_dict
from torchreg.io.atomic import atomic_write, write_text
from torchreg.io.csv_cells import cell_of_text
from torchreg.metrics import pose_errors
from torchreg.types import Clouds, RegistrationResult
from torchreg.verification.likeliest import likeliest_pose

REGISTERED, REFUSED, UNREADABLE, BROKEN = "registered", "refused", "unreadable", "error"
"""States of a pair: a pose that is trusted; none, for a reason; a cloud that cannot be read; a defect of ours."""

RETRIED = (UNREADABLE, BROKEN)
"""States that the next run of the same batch tries again."""

_AS_IN_RECORD = ("reason", "probability", "margin", "fitness", "inlier_rmse", "overlap", "strength",
    "residual_median", "residual_rms", "residual_95")  # fmt: skip


class Bounds(NamedTuple):
    """Errors below which the pose of a pair with a truth counts as found.

    Attributes:
        degrees: of the rotation.
        meters: of the translation; ``None`` takes four inlier thresholds, six times the spacing of the points.

    Example:
        >>> from torchreg.batch import Bounds
        >>> Bounds(degrees=15.0, meters=0.3).meters
        0.3
    """

    degrees: float
    meters: float | None


@dataclass(frozen=True, kw_only=True)
class Row:
    """What is known of one pair when it is done."""

    name: str
    state: str  # one of the four above
    table: dict[str, Any]  # its line; the same whenever and wherever the pair is computed
    seconds: dict[str, float]  # by stage, an even share of what its slice took
    record: dict[str, Any] | None  # the content of its file, the whole result; ``None`` where there was none
    digests: tuple[str, str] = ("", "")  # of both clouds, empty where they were not read

    @staticmethod
    def failed(pair: Pair, reason: str, *, expected: bool) -> Row:
        """The row of a pair that could not be registered."""
        state = UNREADABLE if expected else BROKEN
        missed = {} if pair.truth is None else {"found": False}
        table = _line(pair, {"success": False, "state": state, "reason": reason, **missed})
        return Row(name=pair.name, state=state, table=table, seconds={}, record=None)


COLUMNS: dict[str, str] = {
    "name": "text",
    "source": "text",
    "target": "text",
    "success": "bool",
    "state": "text",
    "reason": "text",
    "T_target_source": "numbers",
    "likeliest_T_target_source": "numbers",
    "probability": "number",
    "margin": "number",
    "fitness": "number",
    "inlier_rmse": "number",
    "overlap": "number",
    "strength": "number",
    "residual_median": "number",
    "residual_rms": "number",
    "residual_95": "number",
    "correspondences": "count",
    "inliers": "count",
    "points_source": "count",
    "points_target": "count",
    "used_source": "count",
    "used_target": "count",
    "voxel_size": "number",
    "inlier_threshold": "number",
    "effort": "text",
    "found": "bool",
    "rre_degrees": "number",
    "rte_meters": "number",
    "rmse_meters": "number",
    "notes": "text",
    "failure": "text",
}
"""The columns of the table in order, with what they hold; other columns of the pairs file follow as texts, with
``pair_`` before a name that is taken. ``failure`` is the kind of a ``Failure``. A pair that was refused has no
``T_target_source``, but where there was one its likeliest pose in ``likeliest_T_target_source``."""


def row_of(
    pair: Pair, result: RegistrationResult, b: int, *, source: Clouds, digests: tuple[str, str], bounds: Bounds
) -> Row:
    """The row of pair ``b`` of a result; ``source`` is its source cloud, over whose points the errors are taken."""
    record = result_to_dict(result, b, seed=pair.settings.seed, source=pair.source_text, target=pair.target_text)
    share = {name: seconds / len(result) for name, seconds in result.seconds}
    success, options, stages = bool(result.success[b]), result.options[b], result.stages[b]
    truth, failure = _errors(pair, result, b, source, bounds), result.failure[b]
    counts: Any = record["counts"]
    known = {
        **{name: record[name] for name in _AS_IN_RECORD},
        "success": success,
        "state": REGISTERED if success else REFUSED,
        **{name: _sixteen(record[name]) for name in ("T_target_source", "likeliest_T_target_source")},
        "correspondences": counts["correspondences"],
        "inliers": counts["inliers"],
        "points_source": stages.given[0],
        "points_target": stages.given[1],
        "used_source": stages.points[0],
        "used_target": stages.points[1],
        "voxel_size": options.voxel_size,
        "inlier_threshold": options.inlier_threshold,
        "effort": options.effort,
        "notes": "; ".join(result.notes[b]),
        "failure": None if failure is None else failure.kind,
        **truth,
    }
    record |= {"name": pair.name, "seconds": share, "truth": truth or None, "settings": pair.settings.flat()}
    line = _line(pair, known)
    return Row(name=pair.name, state=known["state"], table=line, seconds=share, record=record, digests=digests)


def export(folder: Path, lines: Sequence[dict[str, Any]], seconds: Sequence[Mapping[str, float]]) -> None:
    """Write ``results.csv``, ``.json`` and ``.parquet``, and ``times.csv``, each in full or not at all.

    ``lines`` are the rows of the table, ``seconds`` the times by stage, of all pairs in order. In the tables as CSV no
    text is a formula of a spreadsheet (``cell_of_text``).
    """
    extra = list(dict.fromkeys(name for line in lines for name in line if name not in COLUMNS))
    names = [*COLUMNS, *extra]
    stages = list(dict.fromkeys(stage for one in seconds for stage in one))
    times = [{"name": line["name"], **one} for line, one in zip(lines, seconds, strict=True)]
    write_text(folder / "results.csv", _csv(names, lines), through_link=False)
    text = json.dumps(list(lines), indent=1, allow_nan=False) + "\n"
    write_text(folder / "results.json", text, through_link=False)
    with atomic_write(folder / "results.parquet", through_link=False) as file:
        _write_parquet(file, names, lines)
    write_text(folder / "times.csv", _csv(["name", *stages], times), through_link=False)


def _line(pair: Pair, known: dict[str, Any]) -> dict[str, Any]:
    known = {**known, "name": pair.name, "source": pair.source_text, "target": pair.target_text}
    line = {name: known.get(name) for name in COLUMNS}
    taken = {name for name, _ in pair.extra}
    for name, text in pair.extra:
        free = name
        while free in COLUMNS or (free != name and free in taken):
            free = f"pair_{free}"
        line[free] = text
    return line


def _errors(pair: Pair, result: RegistrationResult, b: int, source: Clouds, bounds: Bounds) -> dict[str, Any]:
    """Errors of the pose against the truth, whether it is trusted or not; nothing where either is missing."""
    T_true = pair.transform()
    if T_true is None:
        return {}
    T = likeliest_pose(result, b)
    if T is None or len(source.points) == 0:
        return {"found": False}
    errors = pose_errors(source, T_true, T.cpu())
    meters = 4 * result.options[b].inlier_threshold if bounds.meters is None else bounds.meters
    found = errors.rre_degrees < bounds.degrees and errors.rte_meters < meters
    plain = {name: value if math.isfinite(value) else None for name, value in errors._asdict().items()}
    return {"found": found, **plain}


def _sixteen(T: Any) -> list[float] | None:  # noqa: ANN401
    """A matrix of a record (4 rows of 4) as one list, row by row."""
    return None if T is None else [value for row in T for value in row]


def _csv(names: Sequence[str], lines: Sequence[dict[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(map(cell_of_text, names))
    writer.writerows([_cell(line.get(name)) for name in names] for line in lines)
    return text.getvalue()


def _cell(value: Any) -> Any:  # noqa: ANN401
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return cell_of_text(value)
    return " ".join(map(repr, value)) if isinstance(value, list) else value


def _write_parquet(file: BinaryIO, names: Sequence[str], lines: Sequence[dict[str, Any]]) -> None:
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
    parquet.write_table(pyarrow.table(columns, schema=schema), file)
