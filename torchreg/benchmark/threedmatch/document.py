"""The tables that papers print, a method per row and a scene per column, their caption, and the CSV."""

from __future__ import annotations

from collections.abc import Sequence

from torchreg.benchmark.core.tables import Table, csv_table
from torchreg.benchmark.peers.comparison import MethodComparison
from torchreg.benchmark.peers.method import Method
from torchreg.benchmark.threedmatch import protocol
from torchreg.benchmark.threedmatch.protocol import SceneScore, counts, mean_score, pooled_recall, score

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


def tables(comparison: MethodComparison) -> list[Table]:
    """Registration recall, feature-match recall, inlier ratio, errors and seconds."""
    scenes = list(dict.fromkeys(row["scene"] for row in comparison.rows))
    scores = {method.name: _scores(comparison, method, scenes) for method in comparison.methods}
    made = []
    for measure, heading, digits in _MEASURES:
        pooled = measure == "recall"
        columns = [f"{SCENES.get(scene, scene)} ({_size(comparison, scene, pooled)})" for scene in scenes]
        head = ["method", *columns, "mean", *(["all pairs alike"] if pooled else [])]
        rows = []
        for method in comparison.methods:
            by_scene = scores[method.name]
            if not by_scene:
                rows.append(comparison.empty(method, len(scenes) + 1 + pooled))
                continue
            texts = [_text(by_scene[scene], measure, digits) if scene in by_scene else "-" for scene in scenes]
            cells = [method.title, *texts, _text(mean_score(list(by_scene.values())), measure, digits)]
            rows.append([*cells, _pooled(comparison, method)] if pooled else cells)
        made.append(Table(heading, head, rows))
    return made


def csv_text(comparison: MethodComparison) -> str:
    """One line per scene (or "mean"), method and measure."""
    scenes = list(dict.fromkeys(row["scene"] for row in comparison.rows))
    lines: list[list[object]] = []
    for method in comparison.methods:
        by_scene = _scores(comparison, method, scenes)
        if by_scene:
            for scene, one in {**by_scene, "mean": mean_score(list(by_scene.values()))}.items():
                lines += [
                    [scene, method.name, name, "" if value is None else value] for name, value in one._asdict().items()
                ]
    return csv_table(["scene", "method", "measure", "value"], lines)


def caption(comparison: MethodComparison, voxel: float) -> str:
    """The caption above the tables; ``voxel`` in meters."""
    by_points = any(row["information_rmse_m"] is None for row in comparison.rows)
    parts = [
        f"Clouds averaged over voxels of {voxel:g} m. Registration recall: share of the pairs whose fragments "
        f"are not consecutive, with an error of at most {protocol.RMSE:g} m, the root mean square over the true "
        "matches by the information matrix. Feature-match recall and inlier ratio: of all pairs of the log, matches "
        f"within {protocol.NEAR:g} m under the truth, pairs with more than "
        f"{100 * protocol.LEAST_INLIER_RATIO:g} % of them. RRE and RTE: means over the pairs recalled. Behind a scene, "
        "how many pairs count. The mean is that over scenes; pairs alike have a 95 % percentile interval of 10,000 "
        "bootstrap samples."
    ]
    if by_points:
        parts.append(
            "Where there is no information matrix, the error is taken over the source points of which the truth "
            f"brings a partner within {protocol.NEAR:g} m."
        )
    return "\n\n".join(parts)


def _scores(comparison: MethodComparison, method: Method, scenes: Sequence[str]) -> dict[str, SceneScore]:
    by_scene = {scene: [row for row in comparison.of(method) if row["scene"] == scene] for scene in scenes}
    return {scene: score(rows) for scene, rows in by_scene.items() if rows}


def _size(comparison: MethodComparison, scene: str, counted: bool) -> int:
    return len({row["pair"] for row in comparison.rows if row["scene"] == scene and (counts(row) or not counted)})


def _pooled(comparison: MethodComparison, method: Method) -> str:
    interval = pooled_recall(comparison.of(method), comparison.seed)
    return "-" if interval is None else f"{interval.value:.3f} [{interval.low:.3f}, {interval.high:.3f}]"


def _text(one: SceneScore, measure: str, digits: int) -> str:
    value = getattr(one, measure)
    return "-" if value is None else f"{value:.{digits}f}"
