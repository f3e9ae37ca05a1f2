"""The tables that papers print: a method a row, a scene a column, and the mean over scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from torchreg.benchmark.peers import Method
from torchreg.benchmark.peers.words import how_and_gaps, nothing
from torchreg.benchmark.tables import Table, csv_table, markdown_table
from torchreg.benchmark.threedmatch import protocol
from torchreg.benchmark.threedmatch.protocol import Row, Score, counts, mean_score, pooled_recall, score

SCENES = {
    "7-scenes-redkitchen": "Kitchen",
    "sun3d-home_at-home_at_scan1_2013_jan_1": "Home 1",
    "sun3d-home_md-home_md_scan9_2012_sep_30": "Home 2",
    "sun3d-hotel_uc-scan3": "Hotel 1",
    "sun3d-hotel_umd-maryland_hotel1": "Hotel 2",
    "sun3d-hotel_umd-maryland_hotel3": "Hotel 3",
    "sun3d-mit_76_studyroom-76-1studyroom2": "Study",
    "sun3d-mit_lab_hj-lab_hj_tea_nov_2_2012_scan1_erika": "MIT Lab",
}
"""What papers call the eight test scenes of 3DMatch."""

_MEASURES = (
    ("recall", "Registration recall", 3),
    ("match_recall", "Feature-match recall", 3),
    ("inlier_ratio", "Inlier ratio", 3),
    ("rre_deg", "RRE of pairs recalled, degrees", 2),
    ("rte_m", "RTE of pairs recalled, meters", 3),
    ("seconds", "Seconds a pair", 2),
)


class Findings(NamedTuple):
    """What was measured, and by which methods.

    Attributes:
        rows: one a pair and method.
        methods: those asked for, in order.
        gaps: why some of them could not run, by name.
        voxel: meters, what all clouds were averaged over.
        seed: of the intervals.
    """

    rows: Sequence[Row]
    methods: Sequence[Method]
    gaps: Mapping[str, str]
    voxel: float
    seed: int = 0


def tables(findings: Findings) -> list[Table]:
    """Registration recall, feature-match recall, inlier ratio, errors and seconds."""
    scenes = list(dict.fromkeys(row["scene"] for row in findings.rows))
    scores = {method.name: _scores(findings, method, scenes) for method in findings.methods}
    found = []
    for measure, heading, digits in _MEASURES:
        pooled = measure == "recall"
        head = ["method", *(f"{_called(scene)} ({_size(findings, scene, pooled)})" for scene in scenes), "mean"]
        rows = []
        for method in findings.methods:
            own = scores[method.name]
            if not own:
                rows.append([method.title, *nothing(method, findings.gaps, len(scenes) + 1 + pooled)])
                continue
            by_scene = [_text(own[scene], measure, digits) if scene in own else "-" for scene in scenes]
            cells = [method.title, *by_scene, _text(mean_score(list(own.values())), measure, digits)]
            rows.append([*cells, _pooled(findings, method)] if pooled else cells)
        found.append(Table(heading, [*head, "all pairs alike"] if pooled else head, rows))
    return found


def markdown(findings: Findings, machine: str) -> str:
    """The whole document; ``machine`` is its last line."""
    parts = ["# Registration of fragments by the protocol of 3DMatch", _caption(findings)]
    for table in tables(findings):
        parts += [f"## {table.heading}", markdown_table(table.head, table.rows)]
    parts += how_and_gaps(findings.methods, findings.gaps)
    return "\n\n".join([*parts, machine]) + "\n"


def csv_text(findings: Findings) -> str:
    """One line a scene (or "mean"), method and measure."""
    scenes = list(dict.fromkeys(row["scene"] for row in findings.rows))
    lines: list[list[object]] = []
    for method in findings.methods:
        own = _scores(findings, method, scenes)
        if own:
            for scene, one in {**own, "mean": mean_score(list(own.values()))}.items():
                lines += [
                    [scene, method.name, name, "" if value is None else value] for name, value in one._asdict().items()
                ]
    return csv_table(["scene", "method", "measure", "value"], lines)


def _caption(findings: Findings) -> str:
    by_points = any(row["information_rmse_m"] is None for row in findings.rows)
    parts = [
        f"Clouds averaged over voxels of {findings.voxel:g} m. Registration recall: share of the pairs whose fragments "
        f"do not follow one another with an error of at most {protocol.RMSE:g} m, the root mean square over the true "
        "matches by the information matrix. Feature-match recall and inlier ratio: of all pairs of the log, matches "
        f"within {protocol.NEAR:g} m under the truth, pairs with more than {100 * protocol.MATCHED:g} % of them. RRE "
        "and RTE: means over the pairs recalled. Behind a scene, how many pairs count. The mean is that over scenes; "
        "pairs alike have a 95 % percentile interval of 10,000 bootstrap samples."
    ]
    if by_points:
        parts.append(
            "Where there is no information matrix, the error is taken over the source points of which the truth "
            f"brings a partner within {protocol.NEAR:g} m."
        )
    return "\n\n".join(parts)


def _scores(findings: Findings, method: Method, scenes: Sequence[str]) -> dict[str, Score]:
    own = [row for row in findings.rows if row["method"] == method.name]
    by_scene = {scene: [row for row in own if row["scene"] == scene] for scene in scenes}
    return {scene: score(rows) for scene, rows in by_scene.items() if rows}


def _size(findings: Findings, scene: str, counted: bool) -> int:
    return len({row["pair"] for row in findings.rows if row["scene"] == scene and (counts(row) or not counted)})


def _pooled(findings: Findings, method: Method) -> str:
    interval = pooled_recall([row for row in findings.rows if row["method"] == method.name], findings.seed)
    return "-" if interval is None else f"{interval.value:.3f} [{interval.low:.3f}, {interval.high:.3f}]"


def _called(scene: str) -> str:
    return SCENES.get(scene, scene)


def _text(one: Score, measure: str, digits: int) -> str:
    value = getattr(one, measure)
    return "-" if value is None else f"{value:.{digits}f}"
