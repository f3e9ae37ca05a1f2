"""Large things one at a time: a pair of very many matches, and a cloud of very many points with its peak memory."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import torch

from torchreg.benchmark.core.memory import CAN_MEASURE, peak_bytes
from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.core.study import Cell
from torchreg.benchmark.speed.scene import Scenes
from torchreg.benchmark.speed.side_by_side import side_by_side
from torchreg.benchmark.speed.subjects import CLASSIC, OURS, TENSOR, Run, matched_ransac, with_search
from torchreg.registration import options_for
from torchreg.registration.describe import describe_clouds
from torchreg.solvers import CompatibilityOptions, RansacOptions
from torchreg.solvers.compatibility import compatibility
from torchreg.solvers.ransac import ransac
from torchreg.synthetic.match_problems import match_problem

LARGE = "large"
CAPTION = (
    "Matches of known truth, 95 % of them wrong, by all 600,000 hypotheses and by the graph of compatible ones; a "
    "cloud as it is by all descriptors of the default, Open3D by FPFH alone, peak memory in processes of their own:"
)

_MATCHES, _POINTS = 100_000, 1_000_000
_QUICK_MATCHES, _QUICK_POINTS = 2_000, 2_000
_OUTLIERS, _THRESHOLD = 0.95, 0.05

_MAKE = """
from torchreg.benchmark.speed.large import describing
torch.set_num_threads({threads})
run = describing({points})[{method!r}]
"""


def cells(repeats: int, *, quick: bool) -> Iterator[Cell]:
    """The row of matches and that of points."""
    matches, points = (_QUICK_MATCHES, _QUICK_POINTS) if quick else (_MATCHES, _POINTS)
    solving = f"a pair of {matches:,} matches"
    yield Cell(solving, solving, partial(_solved, solving, matches, repeats))
    case = f"describing {points:,} points"
    yield Cell(case, case, partial(_described, case, points, repeats, quick))


def solving(count: int) -> dict[str, Run]:
    """Ways to solve a pair of so many matches."""
    problem = match_problem(count, _OUTLIERS, noise=_THRESHOLD / 5)
    given = problem.source, problem.target, problem.matches
    every = RansacOptions(inlier_threshold=_THRESHOLD, confidence=1.0)
    return {
        f"{CLASSIC}, RANSAC": matched_ransac(*given, every),
        f"{OURS}, RANSAC": lambda: ransac(*given, every),
        f"{OURS}, compatibility": lambda: compatibility(*given, CompatibilityOptions(inlier_threshold=_THRESHOLD)),
    }


def describing(points: int) -> dict[str, Run]:
    """Ways to describe a cloud of so many points, the search among them."""
    scene = Scenes().scene(points)
    side = scene.source
    options = options_for(side.spacing)
    theirs = with_search(scene)
    return {
        CLASSIC: theirs[CLASSIC],
        TENSOR: theirs[TENSOR],
        f"{OURS}, all descriptors": lambda: describe_clouds(side.cloud, options),
    }


def _solved(case: str, matches: int, repeats: int) -> Row:
    return side_by_side(LARGE, case, solving(matches), repeats)


def _described(case: str, points: int, repeats: int, quick: bool) -> Row:
    runs = describing(points)
    row = side_by_side(LARGE, case, runs, repeats)
    if CAN_MEASURE and not quick:
        threads = torch.get_num_threads()
        made = {method: _MAKE.format(threads=threads, points=points, method=method) for method in runs}
        row["bytes"] = {method: peak_bytes(code, "run()")["bytes"] for method, code in made.items()}
    return row
