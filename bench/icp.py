"""ICP over 32 pairs against Open3D and small_gicp, pair by pair, in one process, the methods in turn.

    python bench/icp.py                   writes bench/results/icp.json and docs/benchmarks/icp.md
    python bench/icp.py --no-docs --pairs 8

Real pairs where they are beside the checkout (voxels v of each pair's ``voxel_m``), else stations of the simulated
mall; starts are the truth, turned by 2 degrees and shifted by v / 2. Correspondences within 1.5 v, at most 30 updates,
Open3D's rule to stop. small_gicp (Levenberg-Marquardt, normals of its own, made before) has a rule of its own, here
1e-5 rad and 1e-5 m. Trees are built in the time counted. Medians of five runs after a warm-up.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from statistics import median
from typing import Any, NamedTuple

import torch
from common import REAL, bench_parser, in_words, interleaved, listed_pairs, machine, publish, save, spread, table
from torch import Tensor

import torchreg as tr
from torchreg.geometry.se3 import apply_rotation, rigid
from torchreg.open3d_loader import load_open3d
from torchreg.refinement import IcpOptions, IcpResult
from torchreg.refinement.gauss_newton import rotation_zyx
from torchreg.refinement.icp import icp

ITERATIONS = 30
KINDS = ("point_to_point", "point_to_plane", "colored", "generalized", "colored_generalized", "hue_point_to_point")
BY_COLOR = ("colored_generalized", "hue_point_to_point")  # which neither of the others has
HEAD = ["32 pairs", "torchreg, one batch", "Open3D", "small_gicp", "Open3D / torchreg", "small_gicp / torchreg",
        "largest difference in T"]  # fmt: skip


class Start(NamedTuple):
    """A pair about its own zeros, where to start from (4, 4), and its voxel size in meters."""

    source: tr.Clouds
    target: tr.Clouds
    T: Tensor
    voxel: float


def perturbed(T: Tensor, number: int, voxel: float) -> Tensor:
    """T after a turn of 2 degrees and a shift of half a voxel."""
    angles, shift = torch.randn(2, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(number))
    turn = torch.deg2rad(2.0 * angles / angles.norm())[None]
    return rigid(rotation_zyx(turn)[0], 0.5 * voxel * shift / shift.norm()) @ T


def made(source: tr.Clouds, target: tr.Clouds, T: Tensor, voxel: float, number: int) -> Start:
    """The pair in float64 with normals; origins are taken out, so that all methods see the same numbers."""
    source, target = (tr.voxel_downsample(cloud, voxel) for cloud in (source, target))
    source, target = (tr.estimate_normals(cloud, tr.neighbors(cloud, 2 * voxel, 30)) for cloud in (source, target))
    T = T.clone()
    T[:3, 3] += apply_rotation(T[:3, :3], source.origin[0]) - target.origin[0]
    zero = torch.zeros_like(source.origin)
    # signs do not matter to any kind, but Open3D's generalized ICP takes normals near -x for x
    bare = (
        replace(cloud, origin=zero, viewpoint=None, normals=cloud.normals * torch.sign(cloud.normals[:, :1] + 1e-12))
        for cloud in (source, target)
    )
    return Start(*bare, perturbed(T, number, voxel), voxel)


def starts(count: int) -> tuple[list[Start], str]:
    """Pairs with colors, and what they are."""
    if not REAL.exists():
        halls = [tr.datasets.mall(seed=seed) for seed in range(4)]
        clouds = [(tr.random_downsample(hall.source, 20_000).to(dtype=torch.float64),
                   tr.random_downsample(hall.target, 20_000).to(dtype=torch.float64),
                   hall.T_target_source.view(4, 4)) for hall in halls]  # fmt: skip
        return [made(*clouds[i % 4], 0.3, i) for i in range(count)], "pairs of the simulated mall"
    listed = [pair for pair in listed_pairs() if pair["colour"]]
    real = []
    for i, pair in enumerate(listed[:count]):
        sides = (tr.read_cloud(REAL / pair[side], dtype=torch.float64) for side in ("source", "target"))
        real.append(made(*sides, torch.tensor(pair["T"], dtype=torch.float64), pair["voxel_m"], i))
    return real, "real pairs"


def torchreg_icp(pairs: list[Start], kind: str) -> Callable[[], IcpResult]:
    source, target = tr.Clouds.pack([p.source for p in pairs]), tr.Clouds.pack([p.target for p in pairs])
    T = torch.stack([p.T for p in pairs])
    options = [IcpOptions(max_distance=1.5 * p.voxel, kind=kind, iterations=ITERATIONS) for p in pairs]
    return lambda: icp(source, target, T, options)


def open3d_icp(pairs: list[Start], kind: str) -> Callable[[], list[Any]]:
    registration = load_open3d().pipelines.registration
    estimation = {
        "point_to_point": registration.TransformationEstimationPointToPoint,
        "point_to_plane": registration.TransformationEstimationPointToPlane,
        "colored": registration.TransformationEstimationForColoredICP,
        "generalized": registration.TransformationEstimationForGeneralizedICP,
    }[kind]()
    method = {
        "colored": registration.registration_colored_icp,
        "generalized": registration.registration_generalized_icp,
    }.get(kind, registration.registration_icp)
    criteria = registration.ICPConvergenceCriteria(1e-6, 1e-6, ITERATIONS)
    ready = [(tr.to_open3d(p.source), tr.to_open3d(p.target), 1.5 * p.voxel, p.T.numpy()) for p in pairs]
    return lambda: [method(*one, estimation, criteria) for one in ready]


def small_gicp_icp(pairs: list[Start], kind: str, threads: int) -> Callable[[], list[Any]] | None:
    try:
        import small_gicp
    except ImportError:
        print("small_gicp is not installed (pip install small-gicp): left out")
        return None
    if kind == "colored":
        return None
    ready = []
    for p in pairs:
        target, source = (small_gicp.PointCloud(cloud.points.numpy()) for cloud in (p.target, p.source))
        small_gicp.estimate_normals_covariances(target, num_neighbors=20, num_threads=threads)
        small_gicp.estimate_normals_covariances(source, num_neighbors=20, num_threads=threads)
        ready.append((target, source, p.T.numpy(), 1.5 * p.voxel))
    name = {"point_to_point": "ICP", "point_to_plane": "PLANE_ICP", "generalized": "GICP"}[kind]
    return lambda: [
        small_gicp.align(target, source, small_gicp.KdTree(target, num_threads=threads), T, name, reach, threads,
                         ITERATIONS, 1e-5, 1e-5)
        for target, source, T, reach in ready
    ]  # fmt: skip


def measured(pairs: list[Start], kind: str, repeats: int, threads: int) -> dict[str, Any]:
    """Seconds of every method, and how far the results agree."""
    ours = torchreg_icp(pairs, kind)
    runs: dict[str, Callable[[], Any]] = {"torchreg": ours}
    if kind in BY_COLOR:
        result = ours()
        updates, converged = int(result.iterations.sum()), int(result.converged.sum())
        return {"seconds": interleaved(runs, repeats), "updates": updates, "converged": converged}
    theirs = open3d_icp(pairs, kind)
    runs["open3d"] = theirs
    other = small_gicp_icp(pairs, kind, threads)
    if other is not None:
        runs["small_gicp"] = other
    result = ours()
    far = torch.stack([torch.from_numpy(one.transformation.copy()) for one in theirs()])
    figures: dict[str, Any] = {
        "seconds": interleaved(runs, repeats),
        "difference_open3d": float((far - result.T_target_source).abs().max()),
        "updates": int(result.iterations.sum()),
        "converged": int(result.converged.sum()),
    }
    if other is not None:
        figures["updates_small_gicp"] = sum(one.iterations for one in other())
    return figures


def row(kind: str, figures: dict[str, Any]) -> list[str]:
    seconds = figures["seconds"]
    base = median(seconds["torchreg"])
    others = [seconds.get("open3d"), seconds.get("small_gicp")]
    return [
        f"{kind.replace('_', '-')}, {figures['updates']} updates",
        spread(seconds["torchreg"]),
        *(spread(other) if other else "-" for other in others),
        *(f"{median(other) / base:.2f}" if other else "-" for other in others),
        f"{figures['difference_open3d']:.0e}" if "difference_open3d" in figures else "-",
    ]


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("--pairs", type=int, default=32, help="how many pairs")
    parser.add_argument("--repeats", type=int, default=5, help="counted runs of each")
    arguments = parser.parse_args()
    threads = torch.get_num_threads()
    if os.environ.get("OMP_NUM_THREADS") not in (None, str(threads)):
        raise SystemExit("OMP_NUM_THREADS and torch disagree: the methods would not get the same threads")
    pairs, what = starts(arguments.pairs)
    points = sum(len(p.source.points) for p in pairs)
    colored = all(p.source.colors is not None for p in pairs)
    kinds = [kind for kind in KINDS if colored or kind not in ("colored", *BY_COLOR)]
    runs = {kind: measured(pairs, kind, arguments.repeats, threads) for kind in kinds}
    head = [f"{len(pairs)} {what}", *HEAD[1:]]
    text = table(head, [row(kind, figures) for kind, figures in runs.items()])
    facts = machine()
    print(text)
    save("icp", {"machine": facts, "pairs": len(pairs), "what": what, "source_points": points, "runs": runs})
    if not arguments.no_docs:
        publish("icp", f"{text}\n\n{in_words(facts)}.")


if __name__ == "__main__":
    main()
