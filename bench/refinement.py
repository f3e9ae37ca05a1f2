"""What refinement at full density adds: errors against known poses, honest deviations, and time.

    python bench/refinement.py                    all parts; with no other load, since the last takes times
    python bench/refinement.py --parts malls,real

Parts: **malls**, the simulated halls 0 to 19, registered with ``refine="none"`` and refined; **real**, the facades
beside the checkout whose truth is better than their points are apart; **coverage**, how often the true pose lies in
the 95 % ellipsoid of the covariance, over 100 simulated pairs (halls and roads of other seeds, starts off by some
0.15 degrees and a tenth of the threshold); **times**, refinement from the poses of the halls, surfels included, beside
point-to-plane ICP on the same clouds by Open3D and small_gicp, from the same starts, thinned to 3 cm, normals included.
Written: bench/results/refinement.json and docs/benchmarks/refinement.md.
"""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import torch
from common import (
    REAL,
    RESULTS,
    bench_parser,
    in_words,
    interleaved,
    listed_pairs,
    machine,
    publish,
    save,
    spread,
    table,
)
from torch import Tensor

import torchreg as tr
from torchreg.geometry.se3 import compose, rigid
from torchreg.metrics import pose_errors
from torchreg.open3d_loader import load_open3d
from torchreg.refinement.gauss_newton import rotation_zyx
from torchreg.refinement.refine import refine_on_surfels
from torchreg.refinement.surfels import surfels_of
from torchreg.registration.options import REFINE_POINTS

MALLS = range(20)
COVERAGE = {"mall": range(500, 550), "road": range(500, 550)}
FACADES = ("eth_facade_tls_nocolour", "sceaux_outdoor")
CHI_SQUARE = {0.5: 5.348, 0.95: 12.592}  # of six degrees of freedom
REACH = 0.6  # meters, the threshold of a hall
TIMED = (0, 7, 14)
ICP_VOXEL, ICP_REACH = 0.03, 0.15  # meters


def mall_row(seed: int) -> dict[str, Any]:
    pair = tr.datasets.mall(seed=seed)
    results = {name: tr.register(pair.source, pair.target, refine=name) for name in ("none", "coarse", "full")}
    T = {name: result.T_target_source[0] for name, result in results.items()}
    errors = {name: pose_errors(pair.source, pair.T_target_source, pose)._asdict() for name, pose in T.items()}
    full = results["full"]
    return {
        "seed": seed,
        "success": bool(full.success[0]),
        "T": T["none"].tolist(),
        "errors": errors,
        "squared": squared(pair.T_target_source, T["full"], full),
        "residual_median": float(full.residual_median[0]),
    }


def real_row(pair: dict[str, Any]) -> dict[str, Any]:
    source, target = (tr.read_cloud(REAL / pair[side], viewpoint="auto") for side in ("source", "target"))
    truth = torch.tensor(pair["T"], dtype=torch.float64)
    results = {name: tr.register(source, target, refine=name) for name in ("none", "full")}
    return {
        "name": pair["name"],
        "success": bool(results["full"].success[0]),
        "errors": {
            name: pose_errors(source, truth, result.T_target_source[0])._asdict() for name, result in results.items()
        },
        "notes": [note for note in results["full"].notes[0] if "not refined" in note],
    }


def coverage_row(job: tuple[str, int]) -> dict[str, Any]:
    torch.set_num_threads(1)
    kind, seed = job
    pair = getattr(tr.datasets, kind)(seed=seed)
    start = compose(off(seed), pair.T_target_source)
    sides = (surfels_of(cloud, REFINE_POINTS) for cloud in (pair.source, pair.target))
    refined = refine_on_surfels(*sides, start[None], [REACH], [False])
    T = refined.T_target_source[0]
    row = {"kind": kind, "seed": seed, "reason": refined.reason[0]}
    if not refined.reason[0]:
        row["squared"] = distance(pair.T_target_source, T, refined.center[0], refined.covariance[0])
        row |= pose_errors(pair.source, pair.T_target_source, T)._asdict()
    return row


def off(seed: int) -> Tensor:
    """A motion (4, 4) by 0.15 degrees and a tenth of the threshold."""
    generator = torch.Generator().manual_seed(seed)
    turn, shift = torch.nn.functional.normalize(torch.randn(2, 3, dtype=torch.float64, generator=generator), dim=1)
    return rigid(rotation_zyx(math.radians(0.15) * turn[None])[0], 0.1 * REACH * shift)


def squared(truth: Tensor, T: Tensor, result: tr.RegistrationResult) -> float | None:
    if result.covariance is None or result.center is None or not bool(torch.isfinite(result.covariance[0]).all()):
        return None
    return distance(truth, T, result.center[0], result.covariance[0])


def distance(truth: Tensor, T: Tensor, center: Tensor, covariance: Tensor) -> float:
    """The squared Mahalanobis distance of the true pose from T."""
    R = truth[:3, :3] @ T[:3, :3].t()
    turn = torch.stack([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2  # of a small angle
    shift = R @ (center - T[:3, 3]) + truth[:3, 3] - center
    apart = torch.cat([turn, shift])
    return float(apart @ torch.linalg.solve(covariance, apart))


def times(repeats: int) -> list[dict[str, Any]]:
    """Seconds and errors of each method, from the pose of ``register`` without refinement."""
    rows = []
    for seed in TIMED:
        pair = tr.datasets.mall(seed=seed)
        start = tr.register(pair.source, pair.target, refine="none").T_target_source[0]
        runs = {"torchreg": by_surfels(pair, start), "Open3D": by_open3d(pair, start)}
        other = by_small_gicp(pair, start)
        if other is not None:
            runs["small_gicp"] = other
        errors = {name: pose_errors(pair.source, pair.T_target_source, run())._asdict() for name, run in runs.items()}
        rows.append({"seed": seed, "seconds": interleaved(runs, repeats), "errors": errors})
        print(rows[-1], flush=True)
    return rows


def by_surfels(pair: tr.datasets.ScanPair, start: Tensor) -> Callable[[], Tensor]:
    def run() -> Tensor:
        sides = (surfels_of(cloud, REFINE_POINTS) for cloud in (pair.source, pair.target))
        return refine_on_surfels(*sides, start[None], [REACH], [False]).T_target_source[0]

    return run


def by_open3d(pair: tr.datasets.ScanPair, start: Tensor) -> Callable[[], Tensor]:
    o3d = load_open3d()
    clouds = [tr.to_open3d(cloud) for cloud in (pair.source, pair.target)]
    registration = o3d.pipelines.registration

    def run() -> Tensor:
        source, target = (cloud.voxel_down_sample(ICP_VOXEL) for cloud in clouds)
        target.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(20))
        plane = registration.TransformationEstimationPointToPlane()
        found = registration.registration_icp(source, target, ICP_REACH, start.numpy(), plane)
        return torch.from_numpy(found.transformation.copy())

    return run


def by_small_gicp(pair: tr.datasets.ScanPair, start: Tensor) -> Callable[[], Tensor] | None:
    try:
        import small_gicp
    except ImportError:
        print("small_gicp is not installed (pip install small-gicp): left out")
        return None
    points = [cloud.points.double().numpy() for cloud in (pair.source, pair.target)]
    threads = torch.get_num_threads()

    def run() -> Tensor:
        source, target = (
            small_gicp.preprocess_points(each, downsampling_resolution=ICP_VOXEL, num_threads=threads)
            for each in points
        )
        found = small_gicp.align(
            target[0], source[0], target[1], start.numpy(), "PLANE_ICP", ICP_REACH, threads, 30, 1e-5, 1e-5
        )
        return torch.from_numpy(found.T_target_source.copy())

    return run


def report(content: dict[str, Any]) -> str:
    """All tables."""
    parts = [render(content[name]) for name, render in TABLES.items() if name in content]
    return "\n\n".join([*parts, f"{in_words(content['machine'])}."])


def malls_table(rows: list[dict[str, Any]]) -> str:
    lines = []
    for name in ("none", "coarse", "full"):
        rte = [1000 * row["errors"][name]["rte_meters"] for row in rows]
        rre = [row["errors"][name]["rre_degrees"] for row in rows]
        worse = sum(row["errors"][name]["rmse_meters"] > row["errors"]["none"]["rmse_meters"] for row in rows)
        lines.append(
            [name, f"{statistics.median(rte):.2f} mm", f"{max(rte):.2f} mm", f"{statistics.median(rre):.4f}",
             f"{max(rre):.4f}", "-" if name == "none" else str(worse)]
        )  # fmt: skip
    head = [f"{len(rows)} simulated halls, refine", "RTE, median", "largest", "RRE (degrees), median", "largest",
            "worse than none"]  # fmt: skip
    return table(head, lines)


def real_table(rows: list[dict[str, Any]]) -> str:
    lines = []
    for row in rows:
        before, after = row["errors"]["none"], row["errors"]["full"]
        cells = [f"{before['rre_degrees']:.3f}", f"{after['rre_degrees']:.3f}"]
        cells += [f"{1000 * each['rte_meters']:.1f}" for each in (before, after)]
        cells += [f"{1000 * each['rmse_meters']:.1f}" for each in (before, after)]
        note = "; ".join(row["notes"]).removeprefix("the pose is not refined: ")
        lines.append([row["name"], *cells, note or ("" if row["success"] else "refused")])
    head = ["real facade", "RRE (degrees)", "refined", "RTE (mm)", "refined", "RMSE (mm)", "refined", "remark"]
    return table(head, lines)


def coverage_table(rows: list[dict[str, Any]]) -> str:
    lines = []
    kinds = dict.fromkeys(row["kind"] for row in rows)
    for kind in (*kinds, "all"):
        of = [row for row in rows if kind in ("all", row["kind"]) and "squared" in row]
        within = [sum(row["squared"] < bound for row in of) / len(of) for bound in CHI_SQUARE.values()]
        lines.append([kind, str(len(of)), *(f"{100 * share:.0f} %" for share in within)])
    head = ["simulated", "pairs refined", *(f"truth within the {100 * share:.0f} % ellipsoid" for share in CHI_SQUARE)]
    return table(head, lines)


def times_table(rows: list[dict[str, Any]]) -> str:
    lines = []
    for name in rows[0]["seconds"]:
        seconds = [second for row in rows for second in row["seconds"][name]]
        rte = statistics.median(1000 * row["errors"][name]["rte_meters"] for row in rows)
        rre = statistics.median(row["errors"][name]["rre_degrees"] for row in rows)
        lines.append([name, spread(seconds), f"{rte:.2f} mm", f"{rre:.4f}"])
    return table(["refined from the same poses by", "seconds", "RTE, median", "RRE (degrees), median"], lines)


TABLES: dict[str, Callable[[list[dict[str, Any]]], str]] = {
    "malls": malls_table,
    "real": real_table,
    "coverage": coverage_table,
    "times": times_table,
}


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("--parts", default=",".join(TABLES), help="which parts to run; the others stay as they were")
    parser.add_argument("--repeats", type=int, default=5, help="counted runs of each timed method")
    arguments = parser.parse_args()
    parts = arguments.parts.split(",")
    before = RESULTS / "refinement.json"
    content: dict[str, Any] = json.loads(before.read_text()) if before.exists() else {}
    content["machine"] = machine()
    if "malls" in parts:
        content["malls"] = [mall_row(seed) for seed in MALLS]
    if "real" in parts:
        content["real"] = [real_row(pair) for pair in listed_pairs() if pair["scene"] in FACADES]
    if "coverage" in parts:
        jobs = [(kind, seed) for kind, seeds in COVERAGE.items() for seed in seeds]
        with ProcessPoolExecutor(torch.get_num_threads()) as pool:
            content["coverage"] = list(pool.map(coverage_row, jobs))
    if "times" in parts:
        content["times"] = times(arguments.repeats)
    save("refinement", content)
    text = report(content)
    print(text)
    if not arguments.no_docs:
        publish("refinement", text)


if __name__ == "__main__":
    main()
