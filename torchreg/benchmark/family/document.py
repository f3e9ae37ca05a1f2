"""The tables of the family, at most 80 characters wide, their caption, and the CSV."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from torchreg.benchmark.core.bootstrap import Interval
from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.tables import Table, csv_table
from torchreg.benchmark.family.fusions import BASES, DEFAULT, FPFH, SUPPORT, WIDE, Fusion
from torchreg.benchmark.family.summary import FIGURES, FamilyScore, difference, found, score
from torchreg.benchmark.field.summary import LEAST_INLIER_RATIO, MATCH_VOXELS, ROTATION, TRANSLATION_VOXELS
from torchreg.benchmark.site.judge import DEGREES

TITLE = "The family of descriptors"

CAPTION = (
    "A name alone: this descriptor alone. +fpfh: fused with FPFH. +color: with the default's color blocks, so that "
    f"{DEFAULT.name} is the default. /wide: support of {WIDE:g} voxels v; else {SUPPORT:g} v. /root: square roots of "
    "histograms. All with the library's options of each descriptor, and solved alike.\n\n"
    f"All but counts, seconds and MB are in percent. Inliers: mean share of mutual matches within {MATCH_VOXELS:g} v "
    f"under the truth. Matched: pairs with more than {100 * LEAST_INLIER_RATIO:g} % of these (feature-match recall). "
    f"Plain: pairs found (within {ROTATION:g} degrees and {TRANSLATION_VOXELS:g} v) by the pose that most matches "
    f"agree on. Found: by all that `register` does; close: within {DEGREES:g} degrees. Wrong: pairs not found that it "
    "calls a success.\n\n"
    "Cost: numbers of a feature; median processor seconds of the descriptors of both clouds, of mutual matches and "
    "their pose, and of the whole pair without neighborhoods and normals, which all share; MB of the features of both "
    "clouds. Verdicts: mean square of the stated probability less the truth (Brier), and its mean over pairs found "
    "and not found.\n\n"
    "Differences are in percent points, pair by pair; in brackets 95 % of 10,000 bootstrap samples of whole scenes."
)

CSV_FIELDS = [
    *("list", "scene", "pair", "overlap", "colored", "voxel_m", "edge_m", "fusion", "dimensions", "bytes", "matches"),
    *("inlier_ratio", "plain_rre_deg", "plain_rte_m", "rre_deg", "rte_m", "success", "probability"),
    *("describe_s", "match_s", "seconds", "error"),
]

_Column = tuple[str, Callable[[FamilyScore], str]]


def document(rows: Sequence[Row], fusions: Sequence[Fusion], machine: str, seed: int = 0) -> str:
    """The whole page as Markdown."""
    return f"# {TITLE}\n\n{sections(rows, fusions, seed)}\n\n{machine}\n"


def sections(rows: Sequence[Row], fusions: Sequence[Fusion], seed: int = 0) -> str:
    """What is counted and all tables; Markdown without a newline at its end."""
    return "\n\n".join([CAPTION, *(table.section for table in tables(rows, fusions, seed))])


def tables(rows: Sequence[Row], fusions: Sequence[Fusion], seed: int = 0) -> list[Table]:
    """With colors and without: shares, and differences from the bases; then cost, verdicts, and shares by scene."""
    made = []
    for words, colored in (("with colors", True), ("without colors", False)):
        part = [row for row in rows if row["colored"] == colored]
        names = _distinct(part, fusions)
        if names:
            made.append(_figures(f"Pairs {words}: {_count(part)} of {_scenes(part)} scenes", part, names, _SHARES))
            bases = BASES if colored else (FPFH,)
            made += [_differences(f"Pairs {words}: less {base.name}", part, names, base, seed) for base in bases]
    names = [fusion.name for fusion in fusions]
    made.append(_figures("Cost", rows, names, _COST))
    if any(row["probability"] is not None for row in rows):
        made.append(_figures("Verdicts", rows, names, _VERDICTS))
    for of_list in dict.fromkeys(row["list"] for row in rows):
        part = [row for row in rows if row["list"] == of_list]
        scenes = list(dict.fromkeys(row["scene"] for row in part))
        for heading, share in _BY_SCENE.items():
            for first in range(0, len(scenes), len(_LETTERS)):
                few = [row for row in part if row["scene"] in scenes[first : first + len(_LETTERS)]]
                made.append(_by_scene(f"{heading}, {of_list} pairs", few, names, share))
    return made


def csv_text(rows: Sequence[Row]) -> str:
    """One line per pair and fusion."""
    return csv_table(CSV_FIELDS, [["" if row[name] is None else row[name] for name in CSV_FIELDS] for row in rows])


def scores(rows: Sequence[Row], fusions: Sequence[Fusion], seed: int = 0) -> list[Row]:
    """A row of figures for every group of pairs and fusion, with its differences from the bases."""
    groups: dict[str, Callable[[Row], bool]] = {
        "all pairs": lambda _: True,
        "with colors": lambda row: bool(row["colored"]),
        "without colors": lambda row: not row["colored"],
    }
    for row in rows:
        groups.setdefault(row["list"], _where("list", row["list"]))
        groups.setdefault(f"{row['list']}/{row['scene']}", _where("scene", row["scene"]))
    made = []
    for group, belongs in groups.items():
        part = [row for row in rows if belongs(row)]
        for fusion in fusions:
            of_fusion = _of(part, fusion.name)
            if of_fusion:
                less = {
                    f"{figure} less {base.name}": difference(of_fusion, _of(part, base.name), get, seed)
                    for base in BASES
                    for figure, get in FIGURES.items()
                }
                made.append({"group": group, "fusion": fusion.name, **score(of_fusion)._asdict(), **less})
    return made


def _figures(heading: str, rows: Sequence[Row], names: Sequence[str], columns: Sequence[_Column]) -> Table:
    """A line for every fusion that has rows, the two that others are set against first."""
    lines = []
    for name in names:
        of_fusion = _of(rows, name)
        if of_fusion:
            cell = score(of_fusion)
            lines.append([name, *(text(cell) for _, text in columns)])
    return Table(heading, ["fusion", *(head for head, _ in columns)], lines)


def _differences(heading: str, rows: Sequence[Row], names: Sequence[str], base: Fusion, seed: int) -> Table:
    others, of_base = [name for name in names if name != base.name], _of(rows, base.name)
    lines = []
    for name in others:
        cells = [difference(_of(rows, name), of_base, FIGURES[figure], seed) for figure in _COMPARED.values()]
        lines.append([name, *map(_signed, cells)])
    return Table(heading, ["fusion", *_COMPARED], lines)


def _by_scene(heading: str, rows: Sequence[Row], names: Sequence[str], share: Callable[[Row], float]) -> Table:
    """A line for every fusion, a column for every scene, which its heading names by letters."""
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    letters = dict(zip(scenes, _LETTERS, strict=False))
    counts = {scene: _count([row for row in rows if row["scene"] == scene]) for scene in scenes}
    legend = ", ".join(f"{letter} {scene} ({counts[scene]})" for scene, letter in letters.items())
    lines = []
    for name in names:
        cells = [[share(row) for row in _of(rows, name) if row["scene"] == scene] for scene in scenes]
        if any(cells):
            lines.append([name, *(_percent(sum(cell) / len(cell)) if cell else "-" for cell in cells)])
    return Table(f"{heading}: {legend}", ["fusion", *letters.values()], lines)


def _distinct(rows: Sequence[Row], fusions: Sequence[Fusion]) -> list[str]:
    """The fusions that have rows; where no pair has colors, without those that add nothing but these."""
    colored = any(row["colored"] for row in rows)
    measured = {row["fusion"] for row in rows}
    return [each.name for each in fusions if each.name in measured and (colored or each.without_color)]


def _of(rows: Sequence[Row], name: str) -> list[Row]:
    return [row for row in rows if row["fusion"] == name]


def _where(field: str, value: str) -> Callable[[Row], bool]:
    return lambda row: bool(row[field] == value)


def _count(rows: Sequence[Row]) -> int:
    return len({(row["list"], row["pair"]) for row in rows})


def _scenes(rows: Sequence[Row]) -> int:
    return len({(row["list"], row["scene"]) for row in rows})


def _percent(share: float) -> str:
    return f"{100 * share:.0f}"


def _signed(interval: Interval | None) -> str:
    if interval is None:
        return "-"
    value, low, high = (f"{100 * number:+.0f}".replace("-0", "0").replace("+0", "0") for number in interval)
    return f"{value} [{low}, {high}]"


def _known(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


_LETTERS = "abcde"

_COMPARED = {"inliers": "inliers", "plain": "plain", "found": "recall"}

_BY_SCENE: dict[str, Callable[[Row], float]] = {
    "Inliers": FIGURES["inliers"],
    "Found": lambda row: float(found(row)),
}

_SHARES: tuple[_Column, ...] = (
    ("pairs", lambda cell: str(cell.pairs)),
    ("inliers", lambda cell: f"{100 * cell.inlier_ratio:.1f}"),
    ("matched", lambda cell: _percent(cell.match_recall)),
    ("plain", lambda cell: _percent(cell.plain_recall)),
    ("found", lambda cell: _percent(cell.recall)),
    ("close", lambda cell: _percent(cell.close_recall)),
    ("wrong", lambda cell: str(cell.wrong)),
)
_COST: tuple[_Column, ...] = (
    ("numbers", lambda cell: "-" if cell.dimensions is None else str(cell.dimensions)),
    ("describe", lambda cell: _known(cell.describe_s, 3)),
    ("match", lambda cell: _known(cell.match_s, 3)),
    ("pair", lambda cell: _known(cell.seconds, 2)),
    ("MB", lambda cell: _known(cell.megabytes, 1)),
    ("failed", lambda cell: str(cell.errors)),
)
_VERDICTS: tuple[_Column, ...] = (
    ("pairs", lambda cell: str(cell.pairs)),
    ("wrong", lambda cell: str(cell.wrong)),
    ("refused", lambda cell: str(cell.refused)),
    ("Brier", lambda cell: _known(cell.brier, 3)),
    ("p, found", lambda cell: _known(cell.probability_right, 2)),
    ("p, not", lambda cell: _known(cell.probability_wrong, 2)),
)
