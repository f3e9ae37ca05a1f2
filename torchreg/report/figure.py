"""Pictures of a registration: the clouds before and after, from three sides, told apart and in true colors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from torch import Tensor

from torchreg.errors import at_least, expect
from torchreg.report.panels import Column, draw_panels
from torchreg.report.scene import Scene, scene_of
from torchreg.types import Clouds

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_RESERVE = 4  # times the points of a panel, since a slice takes a part of them


def registration_figure(
    source: Clouds,
    target: Clouds,
    T_target_source: Tensor | None,
    *,
    title: str = "",
    max_points: int = 20_000,
) -> Figure:
    """Draw two clouds before and after: a column each, from the top, the front and the side.

    Orthographic, to scale, axes in meters in the target's frame. A closed room is cut open: its slice shows
    walls as lines, which lie on each other where the registration is right. The third column is the second in
    true colors, where both clouds have them. The same clouds give the same picture.

    Args:
        source: one cloud.
        target: one cloud.
        T_target_source: (4, 4), origins included; ``None`` draws the column before alone, for a registration
            that failed.
        title: above all.
        max_points: of each cloud in one panel.

    Returns:
        A matplotlib ``Figure`` on the Agg canvas, made without pyplot.

    Raises:
        ValueError: several clouds, another shape of transform, or ``max_points`` below 1.

    Example:
        >>> import torch
        >>> cloud = Clouds(torch.rand(100, 3))
        >>> len(registration_figure(cloud, cloud, torch.eye(4)).axes)
        6
    """
    scene = scene_of(source, target, _RESERVE * at_least(max_points, "max_points", 1))
    columns = [_before(scene)]
    if T_target_source is not None:
        columns.append(Column("after", scene.moved(T_target_source)))
        columns += _true_colors(scene, columns[-1])
    return draw_panels(scene, columns, columns[-1].source, title=title, max_points=max_points)


def demo_figure(
    source: Clouds,
    target: Clouds,
    found: Sequence[tuple[str, Tensor]],
    *,
    title: str = "",
    max_points: int = 20_000,
) -> Figure:
    """Draw what several methods found on one pair side by side, after a column before.

    Args:
        source: one cloud.
        target: one cloud.
        found: heading and transform (4, 4) of every method; the last one is drawn in true colors too and
            decides where rooms are cut open.
        title: above all.
        max_points: of each cloud in one panel.

    Returns:
        A matplotlib ``Figure`` as ``registration_figure`` makes it.

    Raises:
        ValueError: as there, or nothing found.
    """
    expect(len(found) > 0, "found", "at least one method", found)
    scene = scene_of(source, target, _RESERVE * at_least(max_points, "max_points", 1))
    after = [Column(heading, scene.moved(T)) for heading, T in found]
    columns = [_before(scene), *after, *_true_colors(scene, after[-1])]
    return draw_panels(scene, columns, after[-1].source, title=title, max_points=max_points)


def _before(scene: Scene) -> Column:
    source, distance = scene.unmoved()
    return Column(f"before (drawn together: {distance:,.0f} m apart)" if distance else "before", source)


def _true_colors(scene: Scene, column: Column) -> list[Column]:
    if scene.colors is None:
        return []
    return [Column(f"{column.heading}, in true colors", column.source, in_color=True)]
