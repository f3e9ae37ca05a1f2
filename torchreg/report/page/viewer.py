"""A 3D view of any number of clouds as a piece of HTML: turned, moved and zoomed, each cloud toggled on and off.

The viewer is in viewer.js: a cloud is sent once and drawn under the pose of the chosen state, and nothing is fetched
from anywhere. Plotly's 3D scatter plots hold the points once for every pose and draw each as a mesh: without a graphics
card, 100,000 points took them 14 s a frame, and this a quarter of a second.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from torchreg.errors import expect, expect_in_words
from torchreg.report.page.markup import escaped
from torchreg.report.page.packed import packed_bytes, packed_places, packing_order
from torchreg.report.scene import Box, box, padded, union

PALETTE = ("#0d0887", "#4c02a1", "#7e03a8", "#a92395", "#cc4778", "#e56b5d", "#f89540", "#fdc527")
"""From low to high numbers: plasma of matplotlib without its palest end, which white paper would swallow."""

_MARGIN = 0.02
_FEW = 8  # clouds whose names stand in one line or two
_FILES = Path(__file__).parent


@dataclass(frozen=True, eq=False, kw_only=True)
class ViewedCloud:
    """One cloud of a view.

    Attributes:
        name: text beside its box to tick.
        points: (N, 3) float64, meters, finite, in a frame of its own.
        poses: for every state of the view a transform (4, 4), x_view = R x + t, meters. Coordinates in the view should
            be small: they are drawn in float32.
        color: such as ``#d55e00``, in which it is told apart.
        colors: (N, 3) in [0, 1], or ``None``.
        scalars: (N,) numbers in the unit of the view's ``ScalarScale``, or ``None``.
    """

    name: str
    points: NDArray[Any]
    poses: Sequence[NDArray[Any]]
    color: str
    colors: NDArray[Any] | None = None
    scalars: NDArray[Any] | None = None


@dataclass(frozen=True, kw_only=True)
class ScalarScale:
    """What the numbers of the points are, and the range that the colors span; numbers beyond have the last color."""

    name: str
    unit: str
    low: float
    high: float


def viewer_html(
    clouds: Sequence[ViewedCloud],
    *,
    states: Sequence[str] = ("as placed",),
    state: int = 0,
    scale: ScalarScale | None = None,
    up: Sequence[float] = (0.0, 0.0, 1.0),
    axes: Sequence[str] = ("x (m)", "y (m)", "z (m)"),
    label: str = "3D view of the clouds",
    noun: str = "cloud",
) -> str:
    """Make the element of a page that shows clouds in 3D, with its data and its script.

    The page needs ``viewer_style()`` in its head. Places are kept to 1 / 65535 of a cloud's longest edge or better.
    The same clouds give the same text.

    Args:
        clouds: any number; those without colors are drawn gray in true colors, those without scalars by scalar.
        states: names of the states that can be chosen, such as before and after; one alone has no choice.
        state: which is shown first.
        scale: of the scalars; needed where a cloud has some.
        up: (3,) what points up in the view.
        axes: labels of x, y and z of the view's frame.
        label: what the view shows, for those who cannot see it.
        noun: what each of the clouds is.

    Returns:
        A ``<div class="viewer">``.

    Raises:
        ValueError: shapes that do not belong together, a ``state`` out of range, or scalars without a scale.
    """
    expect(0 <= state < len(states), "state", f"a number from 0 to {len(states) - 1}", state)
    for cloud in clouds:
        _check(cloud, len(states), scale)
    content = {
        "clouds": [_cloud_data(cloud, scale) for cloud in clouds],
        "states": [_state_data(clouds, place) for place in range(len(states))],
        "state": state,
        "up": [float(value) for value in up],
        "axes": list(axes),
        "palette": [_bytes_of(color) for color in PALETTE],
    }
    block = json.dumps(content, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return "\n".join(
        (
            '<div class="viewer">',
            '<div class="viewer-stage">',
            f'<canvas tabindex="0" role="img" aria-label="{escaped(label)}"></canvas>',
            '<div class="viewer-labels" aria-hidden="true"></div>',
            "</div>",
            '<form autocomplete="off">',
            *_controls(clouds, states, state, up, noun),
            "</form>",
            *(() if scale is None else (_color_bar(scale),)),
            _bar("height", "Height above the lowest point", ("", "", "")),
            '<p class="viewer-help">Drag: turn. Shift or right button, or two fingers: move. Wheel or pinch: zoom. '
            "Arrow keys, + and - do the same.</p>",
            '<p class="viewer-missing" hidden>The 3D view cannot be drawn: <span></span>. The rest of the page '
            "does not need it.</p>",
            "<noscript><p>The 3D view needs JavaScript, which this page carries itself.</p></noscript>",
            f'<script type="application/json">{block}</script>',
            f"<script>\n{_file('viewer.js')}</script>",
            "</div>",
        )
    )


def viewer_style() -> str:
    """The style sheet of all viewers of a page."""
    return _file("viewer.css")


def _file(name: str) -> str:
    return (_FILES / name).read_text(encoding="utf-8")


def _check(cloud: ViewedCloud, states: int, scale: ScalarScale | None) -> None:
    count, name = len(cloud.points), f"cloud {cloud.name!r}"
    expect(cloud.points.shape == (count, 3), f"{name}, points", "(N, 3)", cloud.points.shape)
    expect_in_words(bool(np.isfinite(cloud.points).all()), f"{name}, points", "finite numbers", "NaN or infinity")
    shapes = [np.shape(pose) for pose in cloud.poses]
    expect(shapes == [(4, 4)] * states, f"{name}, poses", f"(4, 4) for each of {states} states", shapes)
    if cloud.colors is not None:
        expect(cloud.colors.shape == (count, 3), f"{name}, colors", f"({count}, 3)", cloud.colors.shape)
    if cloud.scalars is not None:
        expect(cloud.scalars.shape == (count,), f"{name}, scalars", f"({count},)", cloud.scalars.shape)
        expect(scale is not None, "scale", "one, since a cloud has scalars", scale)


def _controls(
    clouds: Sequence[ViewedCloud], states: Sequence[str], state: int, up: Sequence[float], noun: str
) -> list[str]:
    boxes = "".join(
        f'<label><input type="checkbox" name="cloud" value="{place}" checked>'
        f'<span class="viewer-swatch" style="background:{escaped(cloud.color)}"></span>{escaped(cloud.name)}</label>'
        for place, cloud in enumerate(clouds)
    )
    several = (
        "".join(f'<button type="button" data-show="{what}">{what}</button>' for what in ("all", "none"))
        if len(clouds) > 2
        else ""
    )
    colorings = {
        "scan": f"by {noun}",
        **({"colors": "true colors"} if any(cloud.colors is not None for cloud in clouds) else {}),
        **({"scalars": "by distance"} if any(cloud.scalars is not None for cloud in clouds) else {}),
        "height": "by height",
    }
    poses = {str(place): name for place, name in enumerate(states)}
    views = "".join(
        f'<button type="button" data-view="{view}">{view}</button>' for view in ("oblique", "top", "front", "side")
    )
    return [
        f"<fieldset><legend>{escaped(noun.capitalize())}s</legend>{several}"
        f'<div class="{"viewer-many" if len(clouds) > _FEW else "viewer-few"}">{boxes}</div></fieldset>',
        _radio("Pose", "state", poses, str(state)) if len(states) > 1 else "",
        _radio("Colors", "coloring", colorings, "scan"),
        f"<fieldset><legend>View</legend>{views}{_directions(up)}</fieldset>",
        '<label>Point size <input type="range" name="size" min="0.5" max="6" step="0.5" value="2"></label>',
        "<fieldset><legend>Section</legend>"
        '<label>along <select name="axis"><option value="up" selected>height</option><option value="0">x</option>'
        '<option value="1">y</option><option value="2">z</option></select></label>'
        '<label>from <input type="range" name="from" min="0" max="100" step="0.5" value="0"></label>'
        '<label>to <input type="range" name="to" min="0" max="100" step="0.5" value="100"></label>'
        "<output></output></fieldset>",
    ]


def _directions(up: Sequence[float]) -> str:
    """What can be up: the axes and their opposites, after the direction given where that is none of them."""
    axes = np.concatenate((np.eye(3), -np.eye(3)))[[2, 5, 1, 4, 0, 3]]
    names = dict(zip(map(_vector, axes), ("z", "-z", "y", "-y", "x", "-x"), strict=True))
    given = _vector(up)
    options = "".join(
        f'<option value="{value}"{" selected" if value == given else ""}>{name}</option>'
        for value, name in ({given: "as given"} | names).items()
    )
    return f'<label>Up <select name="up">{options}</select></label>'


def _vector(values: Sequence[float] | NDArray[Any]) -> str:
    return " ".join(f"{float(value) + 0.0:.9g}" for value in values)


def _radio(heading: str, name: str, choices: dict[str, str], chosen: str) -> str:
    buttons = "".join(
        f'<label><input type="radio" name="{name}" value="{value}"{" checked" if value == chosen else ""}>'
        f"{escaped(text)}</label>"
        for value, text in choices.items()
    )
    return f"<fieldset><legend>{heading}</legend>{buttons}</fieldset>"


def _color_bar(scale: ScalarScale) -> str:
    middle = (scale.low + scale.high) / 2
    ends = (f"{scale.low:.4g} {scale.unit}", f"{middle:.4g} {scale.unit}", f"{scale.high:.4g} {scale.unit} or more")
    return _bar("scalars", scale.name, ends)


def _bar(coloring: str, name: str, ends: Sequence[str]) -> str:
    """The colors from low to high that one kind of coloring has, shown while that is chosen."""
    return (
        f'<div class="viewer-scale" data-coloring="{coloring}" hidden>{escaped(name)}'
        f'<div class="bar" style="background:linear-gradient(to right,{",".join(PALETTE)})"></div>'
        f'<div class="ends">{"".join(f"<span>{escaped(end)}</span>" for end in ends)}</div></div>'
    )


def _cloud_data(cloud: ViewedCloud, scale: ScalarScale | None) -> dict[str, object]:
    """Places, colors and scalars as ``packed`` has them."""
    order = packing_order(cloud.points)
    colors = None if cloud.colors is None else packed_bytes(np.rint(255 * np.clip(cloud.colors[order], 0, 1)))
    scalars = None
    if cloud.scalars is not None and scale is not None:
        share = (cloud.scalars[order] - scale.low) / (scale.high - scale.low)
        scalars = packed_bytes(np.rint(255 * np.clip(share, 0, 1))[:, None])
    return {
        **packed_places(cloud.points[order]),
        "color": _bytes_of(cloud.color),
        "colors": colors,
        "scalars": scalars,
        "poses": [np.asarray(pose, dtype=np.float64).tolist() for pose in cloud.poses],
    }


def _state_data(clouds: Sequence[ViewedCloud], place: int) -> dict[str, list[float]]:
    """The box that is drawn and looked at in one state: what most points of all clouds fill."""
    shown: Box | None = None
    for cloud in clouds:
        if len(cloud.points):
            pose = np.asarray(cloud.poses[place], dtype=np.float64)
            corners = box(cloud.points @ pose[:3, :3].T + pose[:3, 3])
            shown = corners if shown is None else union(shown, corners)
    low, high = padded((np.zeros(3), np.ones(3)) if shown is None else shown, _MARGIN)
    return {"low": low.tolist(), "high": high.tolist()}


def _bytes_of(color: str) -> list[int]:
    return list(bytes.fromhex(color.removeprefix("#")))
