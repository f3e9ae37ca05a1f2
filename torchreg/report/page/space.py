"""Both clouds of a pair in 3D: before and after, told apart, in true colors, and by distance."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchreg.neighborhoods.point_index import nearest
from torchreg.report.figures import SOURCE_COLOR, TARGET_COLOR
from torchreg.report.page.markup import paragraph
from torchreg.report.page.reported import ReportedPair
from torchreg.report.page.viewer import ScalarScale, ViewedCloud, viewer_html
from torchreg.report.scene import Scene, scene_of
from torchreg.report.views import axis_label
from torchreg.types import Clouds

_THRESHOLDS = 3.0  # inlier thresholds that the colors of distances span
_MOST = 0.9  # of the distances, where there is no threshold
_ROUND = (1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0)


def space_view(reported: ReportedPair) -> str:
    """The 3D view of a pair as markup, and a sentence on what it shows.

    Upright where up is known (``up_of``); coordinates are relative to the target's origin. Distances are those of the
    source points that are drawn to the nearest of all target points, under the transform or, of a refused pair, its
    likeliest pose.
    """
    scene = scene_of(*reported.clouds, reported.max_points)
    unmoved, apart = scene.unmoved()
    states = [f"before (drawn together: {apart:,.0f} m apart)" if apart else "before"]
    poses = [_shifted(unmoved, scene)]
    distances: NDArray[Any] | None = None
    if reported.pose is not None:
        states.append("after" if reported.facts.success else "likeliest pose, refused")
        poses.append(_drawn_pose(scene, reported.pose))
        distances = _distances(scene.moved(reported.pose) @ scene.frame, scene.clouds[1])
    scale = None if distances is None else _scale(distances, reported)
    split = len(scene.source)
    shown = (split, len(scene.target))
    names = [
        f"{side}: {name}, {_points(count, whole)}"
        for side, name, count, whole in zip(("source", "target"), reported.names, shown, scene.counts, strict=True)
    ]
    source = ViewedCloud(
        name=names[0],
        points=scene.source,
        poses=poses,
        color=SOURCE_COLOR,
        colors=None if scene.colors is None else scene.colors[:split],
        scalars=None if scale is None or distances is None else distances * (1000 if scale.unit == "mm" else 1),
    )
    target = ViewedCloud(
        name=names[1],
        points=scene.target,
        poses=[np.eye(4)] * len(poses),
        color=TARGET_COLOR,
        colors=None if scene.colors is None else scene.colors[split:],
    )
    view = viewer_html(
        (source, target),
        states=states,
        state=len(states) - 1,
        scale=scale,
        axes=[axis_label(scene, axis) for axis in range(3)],
        label=f"3D view of {reported.heading}, {' and '.join(states)}",
    )
    return view + "\n" + paragraph(_caption(reported, scene))


def _caption(reported: ReportedPair, scene: Scene) -> str:
    text = (
        f"At most {reported.max_points:,} points of each cloud are drawn, spread evenly over the space that it fills. "
        "Coordinates are those of the target's frame, in meters"
    )
    origin = scene.clouds[1].origin[0].tolist()
    if any(origin):
        text += ", relative to its origin " + ", ".join(f"{value:.9g}" for value in origin)
    if reported.facts.success:
        return text + "."
    what = "no pose was weighed, so the clouds are shown as they came"
    if reported.pose is not None:
        what = "the likeliest of the poses that were weighed is shown, which is not to be trusted"
    return f"{text}. This pair was refused: {what}."


def _points(count: int, whole: int) -> str:
    return f"{whole:,} points" if count == whole else f"{count:,} of {whole:,} points"


def _shifted(unmoved: NDArray[Any], scene: Scene) -> NDArray[Any]:
    """The pose (4, 4) that places the source as ``Scene.unmoved`` does."""
    pose = np.eye(4)
    pose[:3, :3] = scene.frame
    if len(unmoved):
        pose[:3, 3] = unmoved[0] - scene.turned(scene.source[:1])[0]
    return pose


def _drawn_pose(scene: Scene, T_target_source: Tensor) -> NDArray[Any]:
    """The pose (4, 4) from the source's points to the picture's frame, origins taken out."""
    pose = np.eye(4)
    pose[:3, :3] = scene.frame @ T_target_source[:3, :3].numpy()
    pose[:3, 3] = scene.moved(T_target_source, np.zeros((1, 3)))[0]
    return pose


def _distances(moved: NDArray[Any], target: Clouds) -> NDArray[Any] | None:
    """Meters from points (N, 3) in the target's frame to its nearest finite points; ``None`` where there are none."""
    points = target.points.detach().double()
    points = points[torch.isfinite(points).all(dim=1)]
    if len(points) == 0 or len(moved) == 0:
        return None
    distances: NDArray[Any] = nearest(torch.from_numpy(moved), points).sq_distance.sqrt().numpy()
    return distances


def _scale(distances: NDArray[Any], reported: ReportedPair) -> ScalarScale:
    """From zero to some inlier thresholds, rounded up; in millimeters below a meter."""
    threshold = reported.facts.threshold
    wanted = float(np.quantile(distances, _MOST)) if threshold is None else _THRESHOLDS * threshold
    wanted = max(wanted, 1e-6)
    power = 10.0 ** math.floor(math.log10(wanted))
    high = next((step * power for step in _ROUND if step * power >= wanted * (1 - 1e-9)), 10 * power)
    unit, factor = ("mm", 1000.0) if high < 1 else ("m", 1.0)
    name = "Distance of source points to the nearest target point"
    pose = "after registration" if reported.facts.success else "under the likeliest pose, which was refused"
    return ScalarScale(name=f"{name}, {pose}", unit=unit, low=0.0, high=high * factor)
