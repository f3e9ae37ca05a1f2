"""Speed against Open3D, in one process, the methods in turn.

    python bench/speed.py                 writes bench/results/speed.json and the table in README.md

Two stations of the simulated mall, 10,000 points a cloud drawn as in the paper, normals 2 m / 30, FPFH 5 m / 100, PCFH
2 m, mutual matches, 600,000 hypotheses at confidence 1, so that no luck in an early stop shows. Open3D computes FPFH
alone. Medians of five runs after a warm-up.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from statistics import median

import torch
from common import in_words, interleaved, machine, save, spread, table
from readme import put_into_readme

import torchreg as tr
from torchreg.open3d_loader import load_open3d

POINTS = 10_000
OPTIONS = replace(tr.PAPER, ransac=replace(tr.PAPER.ransac, confidence=1.0))
FPFH_ONLY = replace(OPTIONS, color=(), color_weights=())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--no-readme", action="store_true", help="leave README.md as it is")
    parser.add_argument("--repeats", type=int, default=5, help="counted runs of each")
    arguments = parser.parse_args()

    pair = tr.datasets.mall(seed=0)
    source, target = (tr.random_downsample(cloud, POINTS) for cloud in (pair.source, pair.target))
    near = {name: tr.neighbors(cloud, 5.0, 100) for name, cloud in (("source", source), ("target", target))}
    source = tr.estimate_normals(source, near["source"].restrict(2.0, 30))
    target = tr.estimate_normals(target, near["target"].restrict(2.0, 30))
    features = [tr.fuse(tr.fpfh(cloud, near[name]), tr.pcfh(cloud, near[name].restrict(2.0)))
                for name, cloud in (("source", source), ("target", target))]  # fmt: skip
    matches = tr.match_mutual(*features)

    o3d = load_open3d()
    registration = o3d.pipelines.registration
    clouds = [tr.to_open3d(cloud) for cloud in (source, target)]
    search = o3d.geometry.KDTreeSearchParamHybrid(5.0, 100)
    handed = [_feature(registration, item.values) for item in features]
    pairs = o3d.utility.Vector2iVector(torch.stack([matches.source, matches.target], dim=1).int().numpy())
    checkers = [
        registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
        registration.CorrespondenceCheckerBasedOnDistance(0.2),
    ]

    def open3d_ransac() -> object:
        return registration.registration_ransac_based_on_correspondence(
            *clouds,
            pairs,
            0.2,
            registration.TransformationEstimationPointToPoint(False),
            3,
            checkers,
            registration.RANSACConvergenceCriteria(OPTIONS.ransac.hypotheses, 1.0),
        )

    subjects = {
        "whole registration": (
            lambda: tr.register(source, target, OPTIONS),
            lambda: tr.reference.open3d.register(source, target, FPFH_ONLY),
        ),
        "RANSAC, 600,000 hypotheses": (
            lambda: tr.ransac(source, target, matches, OPTIONS.ransac),
            open3d_ransac,
        ),
        "mutual matching, 10,000 x 10,000 x 44": (
            lambda: tr.match_mutual(*features),
            lambda: registration.correspondences_from_features(*handed, mutual_filter=True),
        ),
        "FPFH, neighborhoods at hand (Open3D: its own search)": (
            lambda: tr.fpfh(source, near["source"]),
            lambda: registration.compute_fpfh_feature(clouds[0], search),
        ),
        "FPFH with its neighbor search": (
            lambda: tr.fpfh(source, tr.neighbors(source, 5.0, 100)),
            lambda: registration.compute_fpfh_feature(clouds[0], search),
        ),
    }
    rows, content = [], {}
    for name, (ours, theirs) in subjects.items():
        seconds = interleaved({"torchreg": ours, "Open3D": theirs}, arguments.repeats)
        ratio = median(seconds["Open3D"]) / median(seconds["torchreg"])
        content[name] = {**seconds, "ratio": ratio}
        rows.append([name, spread(seconds["torchreg"]), spread(seconds["Open3D"]), f"{ratio:.1f}"])
        print(rows[-1], flush=True)
    color = interleaved(
        {
            "FPFH": lambda: describe(source, color=False),
            "FPFH and PCFH": lambda: describe(source, color=True),
        },
        4 * arguments.repeats,
    )
    extra = median(color["FPFH and PCFH"]) / median(color["FPFH"]) - 1
    content["PCFH beside FPFH"] = {**color, "extra": extra}
    facts = machine()
    text = table(["10,000 points a cloud", "torchreg", "Open3D", "times faster"], rows)
    text += (
        f"\n\nPCFH adds {100 * extra:.0f} % to the time of the descriptors (neighbors, normals, FPFH). "
        f"Medians of {arguments.repeats} runs (least to most), {in_words(facts)}."
    )
    print(text)
    save("speed", {"machine": facts, "seconds": content})
    if not arguments.no_readme:
        put_into_readme("speed", text)


def describe(cloud: tr.Clouds, *, color: bool) -> tr.Features:
    """From points to features: neighbors, normals, FPFH, and PCFH if asked for."""
    near = tr.neighbors(cloud, 5.0, 100)
    cloud = tr.estimate_normals(cloud, near.restrict(2.0, 30))
    geometry = tr.fpfh(cloud, near)
    return tr.fuse(geometry, tr.pcfh(cloud, near.restrict(2.0))) if color else tr.fuse(geometry)


def _feature(registration: object, values: torch.Tensor) -> object:
    feature = registration.Feature()  # type: ignore[attr-defined]
    feature.data = values.double().t().numpy()
    return feature


if __name__ == "__main__":
    main()
