"""What stands at the axes of a panel: coordinates in meters, and remarks."""

from __future__ import annotations

from typing import TYPE_CHECKING

from torchreg.report.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AXES = "xyz"


def axis_label(scene: Scene, axis: int) -> str:
    """The name of a coordinate of the target's frame and its unit; what is taken off large ones is said."""
    origin = float(scene.clouds[1].origin[0, axis])
    return f"{AXES[axis]} - {origin:.0f} (m)" if origin else f"{AXES[axis]} (m)"


def note(ax: Axes, text: str) -> None:
    """A remark in the lower left corner of a panel, on white so that points do not hide it."""
    paper = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5}
    ax.annotate(text, (0.01, 0.02), xycoords="axes fraction", fontsize=7, color="0.3", bbox=paper)
