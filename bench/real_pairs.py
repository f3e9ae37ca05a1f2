"""Recall, errors, inlier ratio and time on the real pairs, by scene.

    python bench/real_pairs.py            all pairs; writes bench/results/real_pairs.json and the table in README.md
    python bench/real_pairs.py --scene redkitchen --no-readme
    python bench/real_pairs.py --method "torchreg, fast"    this one again, the others as the JSON has them

All methods get the same clouds, averaged over voxels of each pair's ``voxel_m`` v: normals 2 v / 30, FPFH 5 v / 100,
inlier threshold 1.5 v; RANSAC draws at most 600,000 hypotheses at confidence 0.999. FPFH alone and the paper's rule are
the plain procedure with RANSAC. A pair counts as found when the rotation error is below
15 degrees and the translation error below 6 v. Inlier ratio: share of the mutual matches closer than 2 v under the
truth.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from statistics import mean, median
from typing import Any

import torch
from common import REAL, RESULTS, ROOT, in_words, machine, save, table
from readme import put_into_readme

import torchreg as tr
from torchreg import metrics
from torchreg.registration.describe import downsample
from torchreg.registration.scale import scaled_options

ROTATION_BOUND, TRANSLATION_VOXELS, INLIER_VOXELS = 15.0, 6.0, 2.0

Pair = dict[str, Any]
Method = Callable[[tr.Clouds, tr.Clouds, float], tr.RegistrationResult]


def fpfh_alone(source: tr.Clouds, target: tr.Clouds, voxel: float) -> tr.RegistrationResult:
    return tr.register(source, target, scaled_options(voxel, colored=False), effort="plain", solver="ransac")


def paper_rule(source: tr.Clouds, target: tr.Clouds, voxel: float) -> tr.RegistrationResult:
    """The paper's proportions 2 : 5 : 2 m at this voxel size, 11 bins of hue equalized per cloud, equal weights."""
    color = ("pcfh",) if source.colors is not None else ()
    options = replace(
        tr.PAPER,
        normal_radius=2 * voxel,
        feature_radius=5 * voxel,
        color=color,
        color_weights=(1.0,) * len(color),
        color_radius=2 * voxel,
        ransac=replace(tr.PAPER.ransac, inlier_threshold=1.5 * voxel),
    )
    return tr.register(source, target, options)


def with_effort(effort: str) -> Method:
    """The default at one effort."""

    def method(source: tr.Clouds, target: tr.Clouds, voxel: float) -> tr.RegistrationResult:
        return tr.register(source, target, scaled_options(voxel, colored=source.colors is not None), effort=effort)

    return method


def open3d(source: tr.Clouds, target: tr.Clouds, voxel: float) -> tr.RegistrationResult:
    return tr.reference.open3d.register(source, target, scaled_options(voxel, colored=False))


def open3d_all(source: tr.Clouds, target: tr.Clouds, voxel: float) -> tr.RegistrationResult:
    """Without an early end: all 600,000 hypotheses."""
    options = scaled_options(voxel, colored=False)
    return tr.reference.open3d.register(
        source, target, replace(options, ransac=replace(options.ransac, confidence=1.0))
    )


METHODS: dict[str, Method] = {
    "Open3D FPFH + RANSAC": open3d,
    "Open3D, confidence 1": open3d_all,
    "torchreg, FPFH alone": fpfh_alone,
    "torchreg, paper's rule (44)": paper_rule,
    "torchreg, fast": with_effort("fast"),
    "torchreg, balanced (default)": with_effort("balanced"),
    "torchreg, thorough": with_effort("thorough"),
}


def run(pair: Pair, methods: dict[str, Method]) -> dict[str, Any]:
    """Some methods on one pair."""
    voxel = pair["voxel_m"]
    source, target = (tr.voxel_downsample(tr.read_cloud(REAL / pair[side]), voxel) for side in ("source", "target"))
    truth = torch.tensor(pair["T"], dtype=torch.float64)[None]
    found: dict[str, Any] = {}
    for name, method in methods.items():
        begin = time.perf_counter()
        result = method(source, target, voxel)
        seconds = time.perf_counter() - begin
        rotation, translation = (float(error(truth, result.T_target_source)) for error in (metrics.rre, metrics.rte))
        # fast thins the clouds once more: its matches speak of those points
        used = [downsample(cloud, result.options) for cloud in (source, target)]
        ratio = metrics.inlier_ratio(*used, result.correspondences, truth, INLIER_VOXELS * voxel)
        found[name] = {
            "found": rotation < ROTATION_BOUND and translation < TRANSLATION_VOXELS * voxel,
            "success": bool(result.success),
            "rre_deg": rotation,
            "rte_m": translation,
            "inlier_ratio": float(ratio),
            "matches": len(result.correspondences.source),
            "seconds": seconds,
        }
    return {"name": pair["name"], "scene": pair["scene"], "voxel_m": voxel, "methods": found}


def summary(runs: list[dict[str, Any]]) -> list[list[str]]:
    """Rows of the table: every scene, then all scenes together."""
    rows = []
    scenes = [*dict.fromkeys(run["scene"] for run in runs), "all"]
    for scene in scenes:
        chosen = [run for run in runs if scene in ("all", run["scene"])]
        for name in METHODS:
            cases = [run["methods"][name] for run in chosen]
            hits = [case for case in cases if case["found"]]
            called = sum(case["success"] for case in cases if not case["found"])
            rows.append(
                [
                    scene,
                    name,
                    f"{len(hits)} / {len(cases)}",
                    f"{median(case['rre_deg'] for case in hits):.2f}" if hits else "-",
                    f"{median(case['rte_m'] for case in hits):.3f}" if hits else "-",
                    f"{mean(case['inlier_ratio'] for case in cases):.3f}",
                    f"{median(case['seconds'] for case in cases):.2f}",
                    str(called),
                    str(sum(not case["success"] for case in hits)),
                ]
            )
    return rows


HEAD = [
    "scene",
    "method",
    "found",
    "RRE (deg)",
    "RTE (m)",
    "inlier ratio",
    "seconds",
    "wrong, called right",
    "right, refused",
]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", help="only the pairs of this scene")
    parser.add_argument("--method", choices=list(METHODS), help="only this one again")
    parser.add_argument("--no-readme", action="store_true", help="leave README.md as it is")
    arguments = parser.parse_args()
    if not REAL.exists():
        raise SystemExit(f"the real pairs are not there: {REAL.relative_to(ROOT.parent)} beside the checkout")
    pairs = json.loads((REAL / "pairs.json").read_text())["pairs"]
    pairs = [pair for pair in pairs if arguments.scene in (None, pair["scene"])]
    methods = {arguments.method: METHODS[arguments.method]} if arguments.method else METHODS
    for name, method in methods.items():  # imports and first calls are not counted
        cloud = tr.voxel_downsample(tr.read_cloud(REAL / pairs[0]["source"]), 4 * pairs[0]["voxel_m"])
        print("warm-up:", name, bool(method(cloud, cloud, 4 * pairs[0]["voxel_m"]).success))
    runs = []
    for pair in pairs:
        runs.append(run(pair, methods))
        print(pair["name"], {name: case["found"] for name, case in runs[-1]["methods"].items()}, flush=True)
    facts = machine()
    if arguments.method:
        facts = merged(runs, facts, arguments.method)
    text = table(HEAD, summary(runs))
    print(text)
    if arguments.scene is None:
        save("real_pairs", {"machine": facts, "runs": runs})
        if not arguments.no_readme:
            again = "".join(f"; {name} run again at {commit}" for name, commit in facts.get("again", {}).items())
            put_into_readme("real pairs", f"{text}\n\n{in_words(facts)}{again}.")


def merged(runs: list[dict[str, Any]], facts: dict[str, Any], name: str) -> dict[str, Any]:
    """Fill the runs of one method up with those of all others from the last full run; returns that run's machine."""
    before = json.loads((RESULTS / "real_pairs.json").read_text())
    kept = {case["name"]: case["methods"] for case in before["runs"]}
    for case in runs:
        case["methods"] = {**kept[case["name"]], **case["methods"]}
    again = {**before["machine"].get("again", {}), name: facts["commit"]}
    return {**before["machine"], "again": again}


if __name__ == "__main__":
    main()
