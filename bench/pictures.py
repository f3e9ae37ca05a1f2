"""The pictures of docs/concepts: neighborhoods at two scales, and what each descriptor sees of a hall.

    python bench/pictures.py              writes docs/concepts/neighborhoods.png and docs/concepts/descriptors.png

Two scans of a simulated hall; about a minute on one core.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import torch
from common import DOCS, bench_parser
from torch import Tensor

import torchreg as tr
from torchreg.types import Clouds, Features, Neighborhoods

FOLDER = DOCS / "concepts"
SPACING = 0.25  # meters: voxels of both scans
PERCENT = 2.0  # of the other scan, the most similar points are drawn
INK = "#24292f"


def main() -> None:
    """Draw both pictures."""
    bench_parser(__doc__).parse_args()
    pair = tr.datasets.mall(seed=3, angular_step=0.7, baseline=2.0)
    source, target = (tr.voxel_downsample(cloud, SPACING) for cloud in (pair.source, pair.target))
    FOLDER.mkdir(exist_ok=True)
    plt.rcParams.update({"font.size": 9, "text.color": INK, "axes.labelcolor": INK})
    query = _on_a_sign(source, pair.T_target_source, target)
    _neighborhoods(source, query, FOLDER / "neighborhoods.png")
    _descriptors(source, target, pair.T_target_source, query, FOLDER / "descriptors.png")


def _described(cloud: Clouds) -> tuple[Clouds, Neighborhoods, dict[str, Features]]:
    spacing = float(tr.spacing(cloud)[0])
    near = tr.neighbors(cloud, 5 * spacing, 100)
    cloud = tr.estimate_normals(cloud, near.restrict(2 * spacing, 30))
    blocks = {
        "FPFH": tr.fpfh(cloud, near),
        "contrast": tr.contrast(cloud, near, 5 * spacing),
        "PCFH": tr.pcfh(cloud, near, channels=("hue", "saturation", "value"), equalization="none"),
    }
    blocks["all three"] = tr.fuse(*blocks.values(), weights=(1.0, 0.8, 0.5))
    return cloud, near, blocks


def _on_a_sign(source: Clouds, T: Tensor, target: Clouds) -> int:
    """A point whose surroundings are colorful, and which both scans have."""
    moved = tr.transform(source, T)
    apart = torch.cdist((moved.points + moved.origin).float(), (target.points + target.origin).float()).amin(dim=1)
    near = tr.neighbors(source, 5 * SPACING, 100)
    mask = near.valid[..., None]
    spread = (torch.where(mask, source.colors[near.index], 0) ** 2).sum(1) / mask.sum(1) - (
        torch.where(mask, source.colors[near.index], 0).sum(1) / mask.sum(1)
    ) ** 2
    level = source.points[:, 2].median()
    score = spread.sum(dim=1) * (apart < SPACING) * ((source.points[:, 2] - level).abs() < 1.5) * near.valid.all(dim=1)
    return int(score.argmax())


def _panorama(cloud: Clouds) -> tuple[Tensor, Tensor]:
    """Azimuth and elevation of every point from the scanner, degrees."""
    ray = cloud.points - cloud.viewpoint
    return torch.atan2(ray[:, 1], ray[:, 0]).rad2deg(), torch.asin(ray[:, 2] / ray.norm(dim=1)).rad2deg()


def _neighborhoods(cloud: Clouds, query: int, path: Path) -> None:
    spacing = float(tr.spacing(cloud)[0])
    near = tr.neighbors(cloud, 5 * spacing, 100)
    normal = tr.estimate_normals(cloud, near).normals[query]
    across = torch.linalg.cross(normal, torch.tensor([0.0, 0.0, 1.0]))
    plane = torch.stack([across / across.norm(), torch.tensor([0.0, 0.0, 1.0])])
    flat = (cloud.points - cloud.points[query]) @ plane.T / spacing  # (P, 2), spacings
    shown = (flat.norm(dim=1) < 9) & (((cloud.points - cloud.points[query]) @ normal).abs() < 3 * spacing)
    figure, axes = plt.subplots(1, 3, figsize=(9.5, 4.1), layout="constrained", sharey=True)
    for axis, (radius, most) in zip(axes, ((2.0, 30), (5.0, 30), (5.0, 100)), strict=True):
        kept = near.restrict(radius * spacing, most)
        rows = kept.index[query][kept.valid[query]]
        axis.scatter(*flat[shown].T, s=9, c=cloud.colors[shown].tolist(), edgecolors="#8c959f", linewidths=0.25)
        axis.scatter(*flat[rows].T, s=22, facecolors="none", edgecolors="#d1242f", linewidths=0.9)
        axis.add_patch(plt.Circle((0, 0), radius, fill=False, color="#0969da", linewidth=1.2))
        axis.set(title=f"{radius:g} spacings, at most {most}: {len(rows)} points", aspect="equal", xlabel="spacings")
        axis.set(xlim=(-8, 8), ylim=(-8, 8), xticks=range(-8, 9, 4))
    figure.savefig(path, dpi=120)
    plt.close(figure)


def _descriptors(source: Clouds, target: Clouds, T: Tensor, query: int, path: Path) -> None:
    source, _, ours = _described(source)
    target, _, theirs = _described(target)
    moved = tr.transform(source, T)
    place = (moved.points[query] + moved.origin[0]).to(target.points)
    azimuth, elevation = _panorama(target)
    partner = int((target.points + target.origin[0] - place).norm(dim=1).argmin())
    figure, axes = plt.subplots(len(ours) + 1, 1, figsize=(9.5, 11.5), layout="constrained", sharex=True)
    axes[0].scatter(azimuth, elevation, s=3, c=target.colors.tolist(), linewidths=0)
    axes[0].set_title("the other scan, as its scanner saw it; the circle is where the point belongs")
    for axis, (name, features) in zip(axes[1:], ours.items(), strict=True):
        apart = (theirs[name].values - features.values[query]).norm(dim=1)
        apart = torch.where(theirs[name].valid, apart, torch.inf)
        best = apart <= apart.quantile(PERCENT / 100)
        axis.scatter(azimuth, elevation, s=3, c="#d0d7de", linewidths=0)
        axis.scatter(azimuth[best], elevation[best], s=8, c=-apart[best], cmap="inferno", linewidths=0)
        matches = tr.match_mutual(features, theirs[name])
        right = tr.metrics.inlier_ratio(source, target, matches, T[None], 2 * SPACING)
        rank = int((apart < apart[partner]).sum()) + 1
        axis.set_title(
            f"{name}: the most similar {PERCENT:g} %; the true partner has place {rank:,} of {len(apart):,}; "
            f"of all mutual matches {100 * float(right):.0f} % are right"
        )
    for axis in axes:
        axis.plot(azimuth[partner], elevation[partner], "o", ms=13, mfc="none", mec="#0969da", mew=1.8)
        axis.set(ylabel="elevation", xlim=(-180, 180), ylim=(-60, 60))
    axes[-1].set_xlabel("azimuth, degrees")
    figure.savefig(path, dpi=90)
    plt.close(figure)


if __name__ == "__main__":
    main()
