"""One pair's line in the table of a batch, what it took, and its file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch

from torchreg.batch.pairs import Pair
from torchreg.io import result_to_dict
from torchreg.metrics import pose_errors
from torchreg.types import Clouds, RegistrationResult

REGISTERED, REFUSED, UNREADABLE, BROKEN = "registered", "refused", "unreadable", "error"
"""States of a pair: found and trusted; not trusted, for a reason; a cloud that cannot be read; a defect of ours."""

RETRIED = (UNREADABLE, BROKEN)
"""States that the next run of the same batch tries again."""


class Told(NamedTuple):
    """What a row says beside the result of the registration.

    Attributes:
        digests: of both clouds.
        rotation_bound: degrees; a pair with a truth is found below this error.
        translation_bound: meters; ``None`` takes four inlier thresholds, six times the spacing of the points.
    """

    digests: tuple[str, str]
    rotation_bound: float
    translation_bound: float | None


@dataclass(frozen=True, kw_only=True)
class Row:
    """What is known of one pair when it is done.

    Attributes:
        name: of the pair.
        state: one of the four above.
        table: its line; the same whenever and wherever the pair is computed.
        seconds: by stage, this pair's even share of its slice's.
        record: its file's content, the whole result; ``None`` where there was none.
        digests: of both clouds, empty where they were not read.
    """

    name: str
    state: str
    table: dict[str, Any]
    seconds: dict[str, float]
    record: dict[str, Any] | None
    digests: tuple[str, str] = ("", "")

    @staticmethod
    def failed(pair: Pair, reason: str, *, expected: bool) -> Row:
        """A pair that never came to be registered."""
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
    "probability": "number",
    "margin": "number",
    "fitness": "number",
    "inlier_rmse": "number",
    "overlap": "number",
    "strength": "number",
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
}
"""The table's columns in order, with what they hold; other columns of the pairs file follow as
texts, with ``pair_`` before a name that is taken."""


def row_of(pair: Pair, result: RegistrationResult, b: int, *, source: Clouds, told: Told) -> Row:
    """The row of pair ``b`` of a result; ``source`` is its source cloud, over whose points the errors are taken."""
    record = result_to_dict(result, b, seed=pair.settings.seed, source=pair.source_text, target=pair.target_text)
    share = {name: seconds / len(result) for name, seconds in result.seconds}
    success, options, stages = bool(result.success[b]), result.options[b], result.stages[b]
    truth = _errors(pair, result, b, source, told)
    counts: Any = record["counts"]
    known = {
        **{name: record[name] for name in ("reason", "probability", "margin", "fitness", "inlier_rmse")},
        **{name: record[name] for name in ("overlap", "strength")},
        "success": success,
        "state": REGISTERED if success else REFUSED,
        "T_target_source": result.T_target_source[b].flatten().tolist() if success else None,
        "correspondences": counts["correspondences"],
        "inliers": counts["inliers"],
        "points_source": stages.given[0],
        "points_target": stages.given[1],
        "used_source": stages.points[0],
        "used_target": stages.points[1],
        "voxel_size": options.voxel_size,
        "inlier_threshold": options.ransac.inlier_threshold,
        "effort": options.effort,
        "notes": "; ".join(result.notes[b]),
        **truth,
    }
    record |= {"name": pair.name, "seconds": share, "truth": truth or None, "settings": pair.settings.flat()}
    return Row(
        name=pair.name,
        state=known["state"],
        table=_line(pair, known),
        seconds=share,
        record=record,
        digests=told.digests,
    )


def _line(pair: Pair, known: dict[str, Any]) -> dict[str, Any]:
    own = {"name": pair.name, "source": pair.source_text, "target": pair.target_text}
    line = {name: own.get(name, known.get(name)) for name in COLUMNS}
    taken = {name for name, _ in pair.extra}
    for name, text in pair.extra:
        free = name
        while free in COLUMNS or (free != name and free in taken):
            free = f"pair_{free}"
        line[free] = text
    return line


def _errors(pair: Pair, result: RegistrationResult, b: int, source: Clouds, told: Told) -> dict[str, Any]:
    """How far the pose is from the truth, whether it is trusted or not; nothing where either is missing."""
    T_true = pair.transform()
    if T_true is None:
        return {}
    T = result.T_target_source[b].cpu()
    posed = bool(result.candidates[b]) if result.candidates else not torch.equal(T, torch.eye(4, dtype=T.dtype))
    if not (bool(result.success[b]) or posed) or len(source.points) == 0:
        return {"found": False}
    errors = pose_errors(source, T_true, T)
    bound = told.translation_bound
    if bound is None:
        bound = 4 * result.options[b].ransac.inlier_threshold
    found = errors.rre_degrees < told.rotation_bound and errors.rte_meters < bound
    plain = {name: value if math.isfinite(value) else None for name, value in errors._asdict().items()}
    return {"found": found, **plain}
