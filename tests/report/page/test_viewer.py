"""The 3D view: what its script is given to draw, and what can be chosen."""

from dataclasses import replace

import numpy as np
import pytest
from pages import Page, drawn_bytes, drawn_points
from problems import random_transform, seeded
from refusals import refuses

from torchreg.report.page.packed import BLOCK, packing_order
from torchreg.report.page.viewer import PALETTE, ScalarScale, ViewedCloud, viewer_html, viewer_style

SCALE = ScalarScale(name="distance", unit="mm", low=10.0, high=20.0)


def cloud(count=200, seed=0, **changes):
    draw = np.random.default_rng(seed)
    poses = [np.eye(4), random_transform(seeded(seed)).numpy()]
    made = ViewedCloud(
        name=f"scan {seed}", points=draw.normal(size=(count, 3)) * [5, 2, 1], poses=poses, color="#d55e00"
    )
    return replace(made, **changes)


def view(clouds, states=("before", "after"), **options):
    page = Page(viewer_html(clouds, states=states, **options))
    return page, page.scenes()[0]


@pytest.mark.parametrize("count", [0, 1, 2, 200, 4096, 10000])
def test_points_lie_where_their_poses_put_them(count):
    clouds = [cloud(count, seed) for seed in range(3)]
    _, scene = view(clouds)
    for given, drawn in zip(clouds, scene["clouds"], strict=True):
        assert drawn["count"] == count
        for state, pose in enumerate(given.poses):
            expected = given.points[packing_order(given.points)] @ pose[:3, :3].T + pose[:3, 3]
            finest = np.ptp(given.points, axis=0).max() / 65535 if count else 0
            assert np.abs(drawn_points(drawn, state) - expected).max(initial=0) <= finest + 1e-12


def test_the_box_of_a_state_holds_the_clouds_in_that_state():
    clouds = [cloud(seed=seed) for seed in range(2)]
    _, scene = view(clouds)
    for place, state in enumerate(scene["states"]):
        points = np.concatenate([drawn_points(drawn, place) for drawn in scene["clouds"]])
        assert (points >= state["low"]).all()
        assert (points <= state["high"]).all()
        assert (np.array(state["high"]) - state["low"] < 1.2 * np.ptp(points, axis=0) + 1).all()


def test_colors_and_scalars_are_those_given():
    colors = np.random.default_rng(1).uniform(size=(200, 3))
    scalars = np.linspace(0.0, 30.0, 200)
    page, scene = view([cloud(colors=colors, scalars=scalars), cloud(seed=1)], scale=SCALE)
    first, second = scene["clouds"]
    order = packing_order(cloud().points)
    colors, scalars = colors[order], scalars[order]
    assert np.abs(drawn_bytes(first, "colors") - 255 * colors).max() <= 0.5 + 1e-9
    expected = 255 * np.clip((scalars - 10) / 10, 0, 1)  # beyond the scale the last colors
    assert np.abs(drawn_bytes(first, "scalars") - expected).max() <= 0.5 + 1e-9
    assert (second["colors"], second["scalars"]) == (None, None)
    assert first["color"] == [0xD5, 0x5E, 0x00]
    assert "10 mm" in page.text("span")
    assert "20 mm or more" in page.text("span")


def choices(page, name):
    return [one["value"] for one in page.all("input") if one.get("name") == name]


def test_only_what_is_there_can_be_chosen():
    page, _ = view([cloud()])
    assert choices(page, "coloring") == ["scan", "height"]
    assert choices(page, "state") == ["0", "1"]
    page, scene = view([cloud(poses=[np.eye(4)])], states=("placed",))
    assert choices(page, "state") == []
    assert scene["state"] == 0
    filled = cloud(colors=np.zeros((200, 3)), scalars=np.zeros(200))
    page, _ = view([filled], scale=SCALE)
    assert choices(page, "coloring") == ["scan", "colors", "scalars", "height"]


def test_every_cloud_has_a_box_to_tick_by_its_name():
    names = [f"<{seed}> & 'scan'" for seed in range(7)]
    page, scene = view([cloud(20, seed, name=name) for seed, name in enumerate(names)])
    assert choices(page, "cloud") == [str(place) for place in range(7)]
    assert len(scene["clouds"]) == 7
    assert [text for tag, text in page.texts if tag == "label"][:7] == names


def test_what_is_up_can_be_any_direction():
    page, scene = view([cloud()], up=(0, -1, 0))
    assert scene["up"] == [0, -1, 0]
    assert [one["value"] for one in page.all("option") if "selected" in one] == ["0 -1 0", "up"]
    assert len(page.all("option")) == 6 + 4  # and the axes of the section
    page, _ = view([cloud()], up=(0.6, 0.0, 0.8))
    assert [one["value"] for one in page.all("option") if "selected" in one] == ["0.6 0 0.8", "up"]


def test_text_cannot_end_the_script_that_carries_it():
    page, scene = view([cloud()], axes=("</script><b>x", "y", "z"))
    assert scene["axes"][0] == "</script><b>x"
    assert page.all("b") == []


def test_the_same_clouds_give_the_same_text():
    assert viewer_html([cloud()], states=("a", "b")) == viewer_html([cloud()], states=("a", "b"))
    assert viewer_html([cloud()], states=("a", "b")) != viewer_html([cloud(seed=1)], states=("a", "b"))


def test_what_does_not_belong_together_is_refused():
    for changes, name, parts in (
        ({"points": np.zeros((3, 2))}, "points", ("(N, 3)", "(3, 2)")),
        ({"points": np.full((2, 3), np.nan)}, "points", ("finite",)),
        ({"poses": [np.eye(4)]}, "poses", ("each of 2 states",)),
        ({"colors": np.zeros((3, 3))}, "colors", ("(200, 3)", "(3, 3)")),
        ({"scalars": np.zeros(3)}, "scalars", ("(200,)", "(3,)")),
    ):
        with refuses(f"cloud 'scan 0', {name}", *parts):
            view([cloud(**changes)])
    with refuses("scale", "one"):
        view([cloud(scalars=np.zeros(200))])
    with refuses("state", "0 to 1", "2"):
        view([cloud()], state=2)


def test_the_style_knows_the_classes_of_the_view():
    page, _ = view([cloud(scalars=np.zeros(200))], scale=SCALE)
    for tag in ("div", "p", "span"):
        for attributes in page.all(tag):
            if attributes.get("class"):
                assert f".{attributes['class']}" in viewer_style()
    assert f"const BLOCK = {BLOCK};" in page.text("script")
    assert len(set(PALETTE)) == len(PALETTE)


def test_a_million_points_of_surfaces_with_colors_take_some_ten_megabytes():
    draw = np.random.default_rng(0)
    points = draw.uniform(0, 1, (60_000, 3)) * [20, 12, 3]
    points[np.arange(60_000), draw.integers(0, 3, 60_000)] = 0  # three walls of a hall
    shade = np.repeat(0.5 + 0.4 * np.sin(points[:, :1] + points[:, 1:2]), 3, axis=1) + draw.normal(0, 0.02, (60_000, 3))
    text = viewer_html([cloud(points=points, colors=np.clip(shade, 0, 1), poses=[np.eye(4)])])
    bare = viewer_html([cloud(0, poses=[np.eye(4)])])
    assert (len(text) - len(bare)) / 60_000 < 10.5  # bytes a point; 12 as plain base64
