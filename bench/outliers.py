"""How many wrong matches a solver tolerates: success and time over the outlier ratio, on problems of known truth.

Run as ``python bench/outliers.py``; writes bench/results/outliers.json, docs/outliers.png
and docs/benchmarks/outliers.md.
The problems: points on the walls and the furniture of a room of 10 m, wrong matches between any two of them, noise
of a third of the inlier threshold per coordinate. Every solver gets the same matches and the same threshold, and no
descriptor. A problem is solved when the matched points are within the threshold of where the truth puts them, root
mean square, whatever the solver says of its success.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import torch
from common import DOCS, bench_parser, in_words, machine, publish, save, table
from torch import Tensor

import torchreg as tr
from torchreg.benchmark.peers import METHODS, NOT_HERE
from torchreg.datasets import MatchProblem, match_problem
from torchreg.geometry.se3 import rigid
from torchreg.open3d_loader import load_open3d
from torchreg.solvers import SOLVERS, solve

SHARED = (0.5, 0.8, 0.9, 0.95, 0.97, 0.98, 0.99, 0.995)
RATIOS = {2000: SHARED, 20_000: (*SHARED, 0.999, 0.9995)}
"""By the number of matches: never fewer than ten right ones."""

MOST = 20
THRESHOLD = 0.2
SECONDS = {2000: 4.0, 20_000: 3.0}
"""Of each solver at each ratio; then no further problem is begun, but some are run in any case."""

LEAST = {"torchreg compatibility": MOST}
"""Problems that are run in any case; two for other solvers."""

LOOKS = {
    "torchreg compatibility": ("#0b6e4f", "o"),
    "torchreg ransac": ("#3d9be9", "s"),
    "Open3D RANSAC": ("#8a8a8a", "^"),
    "KISS-Matcher": ("#d1603d", "D"),
}
"""Color and marker; other solvers are black crosses."""

Solver = Callable[[MatchProblem], Tensor]


def by_record(record: type[tr.Solver]) -> Solver:
    """A solver of the library, at its defaults."""

    def run(problem: MatchProblem) -> Tensor:
        return solve(
            problem.source, problem.target, problem.matches, record(inlier_threshold=THRESHOLD)
        ).T_target_source

    return run


def open3d_ransac(problem: MatchProblem) -> Tensor:
    o3d = load_open3d()
    registration = o3d.pipelines.registration
    clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(side.numpy())) for side in matched_points(problem)]
    rows = np.arange(len(problem.matches.source), dtype=np.int32)
    result = registration.registration_ransac_based_on_correspondence(
        *clouds,
        o3d.utility.Vector2iVector(np.stack([rows, rows], axis=1)),
        THRESHOLD,
        registration.TransformationEstimationPointToPoint(False),
        3,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
            registration.CorrespondenceCheckerBasedOnDistance(THRESHOLD),
        ],
        registration.RANSACConvergenceCriteria(600_000, 0.999),
    )
    return torch.from_numpy(np.array(result.transformation))[None]


def kiss_solver(problem: MatchProblem) -> Tensor:
    """Its solver alone, both of its noise bounds the threshold."""
    import kiss_matcher

    config = kiss_matcher.KISSMatcherConfig(voxel_size=THRESHOLD, solver_noise_bound_gain=1.0)
    sides = [list(points.numpy().astype(np.float32)) for points in matched_points(problem)]
    solution = kiss_matcher.KISSMatcher(config).prune_and_solve(*sides)
    R, t = (torch.from_numpy(np.array(part)).double() for part in (solution.rotation, solution.translation))
    return rigid(R, t.reshape(3))[None]


def matched_points(problem: MatchProblem) -> tuple[Tensor, Tensor]:
    """(M, 3) of both sides."""
    return problem.source.points[problem.matches.source], problem.target.points[problem.matches.target]


def solvers() -> tuple[dict[str, Solver], dict[str, str]]:
    """Solvers by name, and why others are left out."""
    by_name: dict[str, Solver] = {
        **{f"torchreg {name}": by_record(record) for name, record in reversed(SOLVERS.items())},
        "Open3D RANSAC": open3d_ransac,
    }
    left_out = {"TEASER++": NOT_HERE["TEASER++"].removesuffix(".")}
    gap = METHODS["kiss-matcher"].gap()
    if gap:
        left_out["KISS-Matcher"] = gap
    else:
        by_name["KISS-Matcher"] = kiss_solver
    return by_name, left_out


def measure(count: int, ratio: float, by_name: dict[str, Solver]) -> dict[str, dict[str, Any]]:
    """Solved problems and seconds of every solver, run in turn on each problem."""
    measured: dict[str, dict[str, Any]] = {name: {"solved": [], "seconds": []} for name in by_name}
    for seed in range(MOST):
        problem = match_problem(count, ratio, place="room", noise=THRESHOLD / 3, seed=seed)
        for name, run in by_name.items():
            if seed >= LEAST.get(name, 2) and sum(measured[name]["seconds"]) > SECONDS[count]:
                continue
            begin = time.perf_counter()
            T = run(problem)
            measured[name]["seconds"].append(time.perf_counter() - begin)
            error = float(tr.metrics.rmse(problem.T_target_source, T, problem.source.points))
            measured[name]["solved"].append(error < THRESHOLD)
    return {
        name: {
            "solved": sum(cell["solved"]),
            "problems": len(cell["solved"]),
            "seconds_median": median(cell["seconds"]),
            "seconds_max": max(cell["seconds"]),
        }
        for name, cell in measured.items()
    }


def draw(cells: list[dict[str, Any]], path: Path) -> None:
    """Two columns, one per number of matches; success above, seconds below. The share of inliers is on a log axis."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    counts = sorted({cell["matches"] for cell in cells})
    figure, axes = plt.subplots(2, len(counts), figsize=(10, 6.2), sharex="col", sharey="row", layout="constrained")
    for column, count in enumerate(counts):
        above, below = axes[:, column]
        for name in reversed(list(dict.fromkeys(cell["solver"] for cell in cells))):  # the first drawn last, on top
            color, marker = LOOKS.get(name, ("black", "x"))
            of_solver = [cell for cell in cells if cell["matches"] == count and cell["solver"] == name]
            if not of_solver:
                continue
            x = [1 - cell["outlier_ratio"] for cell in of_solver]
            style = {"color": color, "marker": marker, "linewidth": 2, "markersize": 6, "clip_on": False}
            above.plot(x, [100 * cell["solved"] / cell["problems"] for cell in of_solver], label=name, **style)
            below.plot(x, [cell["seconds_median"] for cell in of_solver], **style)
        above.set_title(f"{count:,} matches", fontweight="bold")
        above.set_ylim(0, 103)
        below.set_yscale("log")
        below.yaxis.set_major_formatter("{x:g}")
        below.set_xlabel("wrong matches, %")
        for panel in (above, below):
            panel.grid(color="#dddddd", linewidth=0.8)
            panel.spines[["top", "right"]].set_visible(False)
        below.set_xscale("log")
        ratios = RATIOS[count]
        below.set_xlim(0.55, 0.94 * (1 - ratios[-1]))
        below.set_xticks([1 - ratio for ratio in ratios], [f"{100 * ratio:g}" for ratio in ratios], fontsize=8)
        below.minorticks_off()
    axes[0, 0].set_ylabel("problems solved, %")
    axes[1, 0].set_ylabel("median seconds per problem")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles[::-1], labels[::-1], loc="outside upper center", ncols=4, frameon=False)
    numbers = [cell["problems"] for cell in cells]
    figure.supxlabel(f"{min(numbers)} to {max(numbers)} problems a point, fewer where they take long", fontsize=8)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def main() -> None:
    arguments = bench_parser(__doc__).parse_args()
    by_name, left_out = solvers()
    warm_up = match_problem(500, 0.5)
    for run in by_name.values():
        run(warm_up)
    cells = []
    for count, ratios in RATIOS.items():
        for ratio in ratios:
            for name, cell in measure(count, ratio, by_name).items():
                cells.append({"matches": count, "outlier_ratio": ratio, "solver": name, **cell})
    facts = machine()
    save(
        "outliers",
        {"machine": facts, "threshold_m": THRESHOLD, "left_out": left_out, "cells": cells},
    )
    draw(cells, DOCS / "outliers.png")
    tables = []
    for count, ratios in RATIOS.items():
        rows = [
            [name, *(cell_text(cell) for cell in cells if cell["matches"] == count and cell["solver"] == name)]
            for name in by_name
        ]
        head = [f"{count:,} matches, wrong ones", *(f"{100 * ratio:g} %" for ratio in ratios)]
        tables.append(table(head, rows))
    absent = "".join(f" {name}: {why}." for name, why in left_out.items())
    text = "\n\n".join([*tables, f"{in_words(facts)}.{absent}"])
    print(text)
    if not arguments.no_docs:
        publish("outliers", text)


def cell_text(cell: dict[str, Any]) -> str:
    return f"{cell['solved']}/{cell['problems']}, {cell['seconds_median']:.2g} s"


if __name__ == "__main__":
    main()
