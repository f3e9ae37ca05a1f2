"""Pictures: what is drawn, where, and that before and after differ as they should."""

import io

import numpy as np
import pytest
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image
from problems import random_transform, room_pair

import torchreg as tr
from torchreg.report import demo_figure, registration_figure, save_figure
from torchreg.report.figures import SOURCE_COLOR, TARGET_COLOR

DPI = 50


@pytest.fixture(scope="module")
def twin():
    """A cloud, the same cloud elsewhere, and the motion between them."""
    target = room_pair(3000, seed=3).target
    T = random_transform(torch.Generator().manual_seed(1), reach=1.0)
    moved = tr.transform(target, torch.linalg.inv(T))
    source = tr.Clouds(points=moved.points + moved.origin.float(), colors=moved.colors)
    return source, tr.Clouds(points=target.points, colors=target.colors), T


def panel_pixels(figure):
    """(height, width, 3) uint8 of the inside of every panel, by row and column."""
    figure.set_dpi(DPI)
    figure.canvas.draw()
    image = np.asarray(figure.canvas.buffer_rgba())[..., :3]
    panels = {}
    for ax in figure.axes:
        box, place = ax.get_window_extent(), ax.get_subplotspec()
        rows = slice(image.shape[0] - int(box.y1) + 2, image.shape[0] - int(box.y0) - 2)
        columns = slice(int(box.x0) + 2, int(box.x1) - 2)
        panels[place.rowspan.start, place.colspan.start] = image[rows, columns]
    return panels


def ink(pixels):
    """Share of the pixels that are not white."""
    return float((pixels.min(axis=2) < 200).mean())


def test_three_sides_before_after_and_in_colors(twin):
    figure = registration_figure(*twin, title="a title")
    assert isinstance(figure.canvas, FigureCanvasAgg)
    assert not hasattr(figure, "number")  # pyplot numbers its figures; this one is nobody's
    headings = [ax.get_title() for ax in figure.axes]
    assert headings[:3] == ["before", "after", "after, in true colors"]
    assert len(headings) == 9
    assert figure.get_suptitle() == "a title"
    views = [ax.get_ylabel().splitlines()[0] for ax in figure.axes[::3]]
    assert views == ["view along -z", "view along y", "view along -x"]  # a room turned at random
    assert all("(m)" in ax.get_xlabel() for ax in figure.axes)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels[0].startswith("source, ")
    assert labels[1].startswith("target, ")


def test_clouds_that_were_apart_lie_on_each_other(twin):
    panels = panel_pixels(registration_figure(*twin))
    for row in range(3):
        before, after, color = (panels[row, column] for column in range(3))
        assert ink(after) > 0.01
        assert before.shape != after.shape or (before != after).any()
        assert after.shape != color.shape or (after != color).any()


def test_where_they_coincide_less_paper_is_covered(twin):
    """The same points twice cover the panel once; put a little off, they cover more of it."""
    source, target, T = twin
    off = T.clone()
    off[:3, 3] += 0.15
    right, wrong = (panel_pixels(registration_figure(source, target, M))[0, 1] for M in (T, off))
    assert ink(wrong) > 1.15 * ink(right)


def test_neither_cloud_hides_the_other(twin):
    """Mixed drawing: of two clouds at the same place each wins about half of the pixels."""
    source, target, T = twin
    pixels = panel_pixels(registration_figure(source, target, T))[0, 1].reshape(-1, 3).astype(int)

    def near(color):
        wanted = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
        return int((np.abs(pixels - wanted).sum(axis=1) < 60).sum())

    orange, blue = near(SOURCE_COLOR), near(TARGET_COLOR)
    assert min(orange, blue) > 0.4 * max(orange, blue) > 20


def test_the_same_clouds_give_the_same_picture(twin):
    def drawn():
        buffer = io.BytesIO()
        registration_figure(*twin, max_points=500).savefig(buffer, format="png", dpi=DPI)
        return buffer.getvalue()

    assert drawn() == drawn()


def test_without_colors_and_without_a_transform(twin):
    source, target, T = twin
    bare = tr.Clouds(points=source.points)
    assert [ax.get_title() for ax in registration_figure(bare, target, T).axes[:2]] == ["before", "after"]
    assert len(registration_figure(bare, target, T).axes) == 6
    assert [ax.get_title() for ax in registration_figure(source, target, None).axes] == ["before", "", ""]


@pytest.mark.parametrize("count", [0, 1, 2])
def test_tiny_clouds(count):
    cloud = tr.Clouds(points=torch.rand(count, 3), colors=torch.rand(count, 3))
    panel_pixels(registration_figure(cloud, cloud, torch.eye(4, dtype=torch.float64)))
    panel_pixels(registration_figure(cloud, cloud, None))


def test_points_that_are_not_finite_are_left_out(twin):
    source, target, T = twin
    points = source.points.clone()
    points[::5, 2] = float("nan")
    points[1::5, 0] = float("inf")
    panels = panel_pixels(registration_figure(tr.Clouds(points=points, colors=source.colors), target, T))
    assert min(map(ink, panels.values())) > 0.01


def test_clouds_far_from_each_other_are_drawn_together(twin):
    source, target, T = twin
    origin = torch.tensor([[4.5e5, 5.4e6, 300.0]], dtype=torch.float64)
    far = tr.Clouds(points=target.points, colors=target.colors, origin=origin)
    T_far = T.clone()
    T_far[:3, 3] += origin[0]
    figure = registration_figure(source, far, T_far)
    panels = panel_pixels(figure)
    assert "drawn together: 5,418," in figure.axes[0].get_title()
    assert figure.axes[0].get_xlabel() == "x - 450000 (m)"
    near = panel_pixels(registration_figure(source, target, T))
    assert ink(panels[0, 1]) == pytest.approx(ink(near[0, 1]), rel=0.02)
    assert ink(panels[0, 0]) > 0.01


def test_the_pose_of_a_refused_pair_is_drawn_and_marked(twin):
    source, target, T = twin
    refused = registration_figure(source, target, T, refused=True)
    headings = [ax.get_title() for ax in refused.axes[:3]]
    assert headings == ["before", "likeliest pose, refused", "likeliest pose, refused, in true colors"]
    trusted = panel_pixels(registration_figure(source, target, T))
    assert (panel_pixels(refused)[0, 1] == trusted[0, 1]).all()


def test_a_cloud_of_one_color_has_no_true_colors(twin):
    source, target, T = twin
    white = tr.Clouds(points=source.points, colors=torch.ones_like(source.points))
    assert len(registration_figure(white, target, T).axes) == 6


@pytest.mark.parametrize(
    ("shape", "views", "words"),
    [
        ("hall", ["top view, along -z", "front view, along y", "side view, along -x"], "Up is z, from a floor"),
        ("ball", ["view along -z", "view along y", "view along -x"], "Which way is up is not known: no floor"),
    ],
)
def test_views_are_called_top_and_front_only_where_up_is_known(shape, views, words):
    points = torch.nn.functional.normalize(torch.randn(3000, 3, generator=torch.Generator().manual_seed(0)), dim=1)
    cloud = tr.Clouds(points=points)
    if shape == "hall":
        cloud = tr.datasets.mall(seed=1, angular_step=1.5).target
        cloud = tr.Clouds(points=cloud.points, viewpoint=cloud.viewpoint)
    figure = registration_figure(cloud, cloud, torch.eye(4))
    assert [ax.get_ylabel().splitlines()[0] for ax in figure.axes[::2]] == views
    assert figure.legends[0].get_title().get_text().startswith(words)


def test_demo_figure(twin):
    source, target, T = twin
    figure = demo_figure(source, target, [("one: wrong", torch.eye(4)), ("two: right", T)])
    headings = [ax.get_title() for ax in figure.axes[:4]]
    assert headings == ["before", "one: wrong", "two: right", "two: right, in true colors"]
    panels = panel_pixels(figure)
    assert ink(panels[0, 0]) == pytest.approx(ink(panels[0, 1]), rel=0.01)  # the identity is how it was
    assert panels[0, 1].shape != panels[0, 2].shape or (panels[0, 1] != panels[0, 2]).any()


def test_refusals(twin):
    source, target, T = twin
    batch = tr.Clouds.pack([source, source])
    with pytest.raises(ValueError, match="source: expected a batch of one"):
        registration_figure(batch, target, T)
    with pytest.raises(ValueError, match="T_target_source"):
        registration_figure(source, target, T[None])
    with pytest.raises(ValueError, match="max_points"):
        registration_figure(source, target, T, max_points=0)
    with pytest.raises(ValueError, match="transforms"):
        demo_figure(source, target, [])


def test_titles_are_not_taken_for_formulas(twin):
    panel_pixels(registration_figure(*twin, title="$\\nonsense$ a_$.ply \udcff\x1b"))


@pytest.mark.parametrize(("suffix", "start"), [("png", b"\x89PNG"), ("pdf", b"%PDF"), ("SVG", b"<?xml")])
def test_save(twin, tmp_path, suffix, start):
    figure = registration_figure(*twin, max_points=300)
    path = tmp_path / f"picture.{suffix}"
    save_figure(figure, path, dpi=DPI)
    assert path.read_bytes().startswith(start)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    if suffix == "png":
        with Image.open(path) as image:
            size = image.size
        assert size == tuple(np.floor(figure.get_size_inches() * DPI + 1e-6).astype(int))


def test_save_refuses(twin, tmp_path):
    figure = registration_figure(*twin, max_points=10)
    for name in ("picture.gif", "picture", "picture.png.txt"):
        with pytest.raises(ValueError, match=r"a name that ends in \.png, \.pdf, \.svg"):
            save_figure(figure, tmp_path / name)
    with pytest.raises(ValueError, match="folder"):
        save_figure(figure, tmp_path / "none" / "picture.png")
    assert list(tmp_path.iterdir()) == []
