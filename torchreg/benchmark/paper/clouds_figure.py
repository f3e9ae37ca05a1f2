"""Pictures in the manner of the paper's Figures 3 to 6: the drawn points in their initial pose, and registered.

The source stands as it was scanned, upright; the target is drawn where the initial pose puts it, and then where each
method takes it. Registered rooms are cut open like a plan, so that walls show as lines.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.paper.methods import METHODS
from torchreg.geometry.se3 import apply, inverse
from torchreg.metrics.pose import PoseErrors
from torchreg.report.canvas import add_legend, blank_figure, set_limits
from torchreg.report.figures import SOURCE_COLOR, TARGET_COLOR
from torchreg.report.scene import box, padded
from torchreg.report.views import VIEWS, slice_of
from torchreg.types import Clouds

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WIDTH = 3.7  # inches of a panel
_AZIMUTH, _ELEVATION = np.deg2rad(-60.0), np.deg2rad(28.0)
_MARGIN = 0.05
_SHAPE = 0.8  # of a panel: its height over its width


class Shown(NamedTuple):
    """A row of panels: heading, clouds with the target in its initial pose, the truth, and the rows by method."""

    heading: str
    source: Clouds
    target: Clouds
    T_target_source: Tensor
    rows: Mapping[str, Row]


def clouds_figure(settings: Sequence[Shown], title: str) -> Figure:
    """Draw a row of panels for each setting, the first on top: the initial pose, and the pose of every method."""
    kinds = 1 + len(METHODS)
    size = (_WIDTH * kinds + 0.4, _SHAPE * _WIDTH * len(settings) + 1.2)
    figure = blank_figure(size, title, fontsize=12, columns=120)
    for shown, axes in zip(settings, figure.subplots(len(settings), kinds, squeeze=False), strict=True):
        source, target = (_upright(cloud, None) for cloud in (shown.source, shown.target))
        views = _oblique(source), _oblique(target)
        _scatter(axes[0], *views, np.concatenate(views))
        axes[0].set_ylabel(shown.heading, fontsize=9)
        axes[0].set_xlabel("seen aslant from above", fontsize=8)
        for method, ax in zip(METHODS, axes[1:], strict=True):
            _registered(ax, shown, method, source)
    for text, ax in zip(("initial pose", *METHODS), figure.axes[:kinds], strict=True):
        ax.set_title(text, fontsize=10)
    add_legend(figure, {"source": SOURCE_COLOR, "target": TARGET_COLOR})
    return figure


def _registered(ax: Axes, shown: Shown, method: str, whole: NDArray[Any]) -> None:
    """Draw the plan of both clouds under the pose of a method; the slice is that of the truth."""
    row = shown.rows.get(method)
    if row is None:
        ax.set_axis_off()
        return
    true = _upright(shown.target, shown.T_target_source)
    cut = slice_of(np.concatenate((whole, true)), VIEWS[0])
    source, moved = whole, _upright(shown.target, torch.tensor(row["T_target_source"], dtype=torch.float64))
    if cut is not None:
        source, moved = (points[(points[:, 2] >= cut[0]) & (points[:, 2] <= cut[1])] for points in (whole, moved))
    _scatter(ax, source[:, :2], moved[:, :2], np.concatenate((whole, true))[:, :2])
    rre, rte, rmse = (row[name][0] for name in PoseErrors._fields)  # of the run whose transform the row keeps
    ax.set_xlabel(f"RRE {rre:.2f}°, RTE {rte:.3f} m, RMSE {rmse:.3f} m", fontsize=8)


def _upright(cloud: Clouds, T_target_source: Tensor | None) -> NDArray[Any]:
    """Points (P, 3) in the frame that the source was scanned in; as they are without a transform."""
    points = cloud.points.detach().cpu().double() + cloud.origin.cpu()
    moved: NDArray[Any] = (points if T_target_source is None else apply(inverse(T_target_source), points)).numpy()
    return moved


def _oblique(points: NDArray[Any]) -> NDArray[Any]:
    """Orthographic picture (P, 2), meters, z up."""
    c, s = np.cos(_AZIMUTH), np.sin(_AZIMUTH)
    right = np.array([-s, c, 0])
    up = np.array([-c * np.sin(_ELEVATION), -s * np.sin(_ELEVATION), np.cos(_ELEVATION)])
    flat: NDArray[Any] = points @ np.stack((right, up), axis=1)
    return flat


def _scatter(ax: Axes, source: NDArray[Any], target: NDArray[Any], extent: NDArray[Any]) -> None:
    """Draw both clouds, their points mixed so that neither hides the other, in a panel that shows what most points
    (P, 2) of ``extent`` fill."""
    points = np.concatenate((source, target))
    rows = np.random.default_rng(0).permutation(len(points))
    color = np.where(rows < len(source), SOURCE_COLOR, TARGET_COLOR)
    size = float(np.clip(12_000 / max(len(rows), 1), 0.8, 8.0))
    ax.scatter(points[rows, 0], points[rows, 1], s=size, c=color, marker="s", linewidths=0, rasterized=True)
    ax.tick_params(labelsize=7)
    set_limits(ax, *padded(box(extent), _MARGIN), _SHAPE)
