"""The page on one pair: what it says and shows, that it needs nothing from outside, and that text stays text."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from pages import Page, drawn_bytes, drawn_points
from problems import room_pair
from refusals import refuses

import torchreg as tr
from torchreg.report import registration_table, report_html, write_report
from torchreg.report.page.sections import SECTIONS
from torchreg.report.text import chance

UTM = torch.tensor([[500_000.0, 5_200_000.0, 300.0]], dtype=torch.float64)
NASTY = ("<script>alert(1)</script>&\"'.ply", "\x1b[31m b</title>.ply")


@pytest.fixture(scope="module")
def pairs():
    """A room, and two different rooms, as one batch, with their result; the clouds lie far from zero."""
    room, other = room_pair(4000, seed=1), room_pair(4000, seed=5)
    source = tr.Clouds.pack([room.source, room.source])
    target = tr.Clouds.pack([room.target, other.target])
    source, target = (replace(clouds, origin=clouds.origin + UTM) for clouds in (source, target))
    result = tr.register(source, target, seed=0)
    assert bool(result.success[0])
    return source, target, result


@pytest.fixture(scope="module")
def refused():
    """A pair without agreement, which has candidates all the same."""
    room = room_pair(3000, seed=1)
    draw = torch.Generator().manual_seed(0)
    noise = tr.Clouds(points=torch.rand(3000, 3, generator=draw) * 4, colors=torch.rand(3000, 3, generator=draw))
    result = tr.register(room.source, noise, seed=0)
    assert not bool(result.success[0])
    assert result.candidates[0]
    return room.source, noise, result


@pytest.fixture(scope="module")
def text(pairs):
    source, target, result = pairs
    return report_html(result, source, target, 0, names=("a.ply", "b.ply"), file_notes=["source: a note"])


@pytest.fixture(scope="module")
def page(text):
    return Page(text)


def test_it_has_the_parts_of_a_page(page):
    assert "torchreg: a.ply to b.ply" in [text for tag, text in page.texts if tag == "title"]
    assert [tag for tag, _ in page.elements if tag in ("html", "head", "body", "main", "h1")] == [
        *("html", "head", "body"),
        *("h1", "main"),
    ]
    headings = page.text("h2").split("\n")
    assert headings[:5] == ["Verdict", "The clouds in 3D", "Numbers", "Transform", "Pictures"]
    assert headings[5:] == ["Candidates", "What each stage did", "Notes on the files", "Options and versions"]
    assert len(page.all("section")) == len(headings) == len(SECTIONS)
    assert page.all("html")[0]["lang"] == "en"
    assert "source: a note" in page.text("li")


def test_nothing_comes_from_outside(text, page):
    for tag, attributes in page.elements:
        for name in ("src", "href", "action", "data", "srcset", "poster"):
            assert attributes.get(name, "data:").startswith("data:"), (tag, name)
        assert tag not in ("link", "iframe", "object", "embed", "base")
    assert not re.search(
        r"https?:|url\(|@import|\bfetch\(|XMLHttpRequest|\bimport\b|WebSocket|sendBeacon|src\s*=\s*[^\"]", text
    )
    policy = [one["content"] for one in page.all("meta") if one.get("http-equiv") == "Content-Security-Policy"]
    assert policy
    assert policy[0].startswith("default-src 'none'; ")
    assert "http" not in policy[0]


def test_every_row_of_the_table_is_there(page, pairs):
    table = registration_table(pairs[2], 0, source="a.ply: 1 point", target="b.ply: 1 point")
    said = page.text()
    names, values = (list(column.cells) for column in table.columns)
    for name, value in list(zip(names, values, strict=True))[2:]:
        assert str(name) in said
        assert str(value) in said, name


def test_verdict_transform_candidates_and_versions(page, pairs):
    result = pairs[2]
    said = page.text("p")
    assert re.search(r"Registered, probability 0\.\d+ that the pose is right|Registered, probability 1", said)
    assert {"class": "registered"} in page.all("p")
    T = result.T_target_source[0]
    w, x, y, z = (float(v) for v in re.search(r"([-\d.]+), ([-\d.]+), ([-\d.]+), ([-\d.]+)", page.text("td")).groups())
    assert abs(w * w + x * x + y * y + z * z - 1) < 1e-9
    assert abs(float(torch.trace(T[:3, :3])) - (4 * w * w - 1)) < 1e-9
    assert ", ".join(f"{value:.9f}" for value in T[:3, 3].tolist()) in page.text("td")
    assert result.explain(0) in page.text("pre")
    assert sum(candidate.origin in page.text("td") for candidate in result.candidates[0]) == len(result.candidates[0])
    assert torch.__version__ in page.text("td")
    assert '"inlier_threshold"' in page.text("pre")


def test_pictures_have_words(page):
    images = page.all("img")
    assert len(images) == 2
    assert all(
        one["src"].startswith("data:image/png;base64,iVBOR") and "a.ply to b.ply" in one["alt"] for one in images
    )


def test_the_clouds_lie_on_each_other_after_and_not_before(page, pairs):
    (scene,) = page.scenes()
    source, target = scene["clouds"]
    assert scene["state"] == 1
    apart = []
    for state in range(2):
        one, other = drawn_points(source, state), drawn_points(target, state)
        assert np.abs(other).max() < 100  # relative to the target's origin
        apart.append(np.median(np.sqrt(((one[::7, None] - other[None]) ** 2).sum(-1)).min(1)))
    assert apart[1] < 0.1 < apart[0]
    assert scene["axes"] == ["x - 500000 (m)", "y - 5200000 (m)", "z - 300 (m)"]


def test_points_are_colored_by_their_distance_to_the_other_cloud(page, pairs):
    (scene,) = page.scenes()
    one, other = (drawn_points(cloud, 1) for cloud in scene["clouds"])
    nearest = np.sqrt(((one[:, None] - other[None]) ** 2).sum(-1)).min(1)  # all points of the target are drawn
    high, unit = re.search(r"([\d.]+) (mm|m) or more", page.text("span")).groups()
    high = float(high) / (1000 if unit == "mm" else 1)
    threshold = pairs[2].options[0].inlier_threshold
    assert 3 * threshold <= high * (1 + 1e-6) <= 6.1 * threshold
    expected = 255 * np.clip(nearest / high, 0, 1)
    assert np.abs(drawn_bytes(scene["clouds"][0], "scalars") - expected).max() < 1.0
    assert len(np.unique(drawn_bytes(scene["clouds"][0], "scalars"))) > 20


def test_clouds_are_thinned_to_the_number_that_is_named(pairs):
    source, target, result = pairs
    page = Page(report_html(result, source, target, max_points=500))
    assert [cloud["count"] for cloud in page.scenes()[0]["clouds"]] == [500, 500]
    assert "At most 500 points of each cloud" in page.text("p")
    assert f"500 of {len(source.select(0).points):,} points" in page.text("label")


@pytest.mark.slow
def test_the_same_result_gives_the_same_page(pairs, text):
    source, target, result = pairs
    again = report_html(result, source, target, 0, names=("a.ply", "b.ply"), file_notes=["source: a note"])
    assert again == text
    rerun = replace(tr.register(source, target, seed=0), seconds=result.seconds)  # times alone differ between runs
    assert report_html(rerun, source, target, 0, names=("a.ply", "b.ply"), file_notes=["source: a note"]) == text


def test_text_from_files_stays_text(pairs, page):
    source, target, result = pairs
    nasty = Page(report_html(result, source, target, names=NASTY, file_notes=['<img src="x" onerror="y">']))
    assert [tag for tag, _ in nasty.elements if tag in ("script", "img", "title")] == [
        tag for tag, _ in page.elements if tag in ("script", "img", "title")
    ]
    assert NASTY[0] in nasty.text("h1")
    assert "\\x1b[31m b</title>.ply" in nasty.text("h1")
    assert "\x1b" not in nasty.text()
    assert '<img src="x" onerror="y">' in nasty.text("li")
    assert all(NASTY[0] in one["alt"] for one in nasty.all("img"))


def test_a_refused_pair_shows_its_likeliest_pose_and_says_that_it_is_none(refused):
    source, target, result = refused
    page = Page(report_html(result, source, target))
    said = page.text("p")
    assert f"Not registered, probability {chance(float(result.probability[0]))} that the pose is right" in said
    assert result.reason[0] in said
    assert "What may help" in page.text("h3")
    assert "This pose was refused; it is no result." in said
    assert "likeliest of the poses" in said
    assert "likeliest pose, refused" in page.text("label")
    assert "T_target_source" not in page.text("th")
    (scene,) = page.scenes()
    T = result.candidates[0][0].T_target_source
    expected = (source.points.double() @ T[:3, :3].T + T[:3, 3]).numpy()  # drawn in another order
    moved = drawn_points(scene["clouds"][0], 1)
    assert np.sqrt(((moved[:, None] - expected[None]) ** 2).sum(-1)).min(1).max() < 1e-3


def test_a_pair_for_which_no_pose_was_weighed_is_shown_as_it_came():
    few = tr.Clouds(points=torch.eye(3))
    room = room_pair(2000, seed=1).target
    result = tr.register(few, room, seed=0)
    page = Page(report_html(result, few, room))
    assert len(page.scenes()[0]["states"]) == 1
    assert "no pose was weighed" in page.text("p")
    assert "Transform" not in page.text("h2")
    assert "Candidates" not in page.text("h2")
    assert result.reason[0] in page.text("p")


def test_without_colors_there_are_no_true_colors(pairs):
    source, target, result = pairs
    bare = replace(source, colors=None)
    assert "true colors" in Page(report_html(result, source, target)).text("label")
    page = Page(report_html(result, bare, target))
    assert "true colors" not in page.text("label")
    assert all(cloud["colors"] is None for cloud in page.scenes()[0]["clouds"])


def test_the_result_of_a_solver_alone_has_a_page(pairs):
    source, target, result = pairs
    bare = replace(
        result,
        **dict.fromkeys(("probability", "overlap", "information", "strength", "runner_up", "margin")),
        **dict.fromkeys(("options", "notes", "seconds", "candidates", "stages"), ()),
    )
    page = Page(report_html(bare, source, target))
    assert "Registered" in page.text("p")
    assert "by distance" in page.text("label")


def test_sections_can_be_added_and_left_out(pairs):
    source, target, result = pairs

    def residuals(reported):
        return f"<section><h2>{reported.facts.inliers} inliers</h2></section>"

    page = Page(report_html(result, source, target, sections=(SECTIONS[0], residuals)))
    assert page.text("h2").split("\n") == [
        "Verdict",
        f"{int(result.inliers[: result.correspondences.offsets[1]].sum())} inliers",
    ]


def test_a_page_is_written_in_full_or_refused(pairs, tmp_path, text, monkeypatch):
    monkeypatch.chdir(tmp_path)
    source, target, result = pairs
    path = tmp_path / "page.html"
    write_report(path, result, source, target, names=("a.ply", "b.ply"), file_notes=["source: a note"])
    assert path.read_text(encoding="utf-8") == text
    with refuses("path", ".html", "page.pdf"):
        write_report(Path("page.pdf"), result, source, target)
    with refuses("pair", "0 to 1", "2"):
        write_report(path, result, source, target, 2)
    with refuses("max_points", "1"):
        report_html(result, source, target, max_points=0)
    with refuses("source", "the 2 clouds that were registered"):
        report_html(result, source.select(0), target)
    with refuses("target", "other origins"):
        report_html(result, source, replace(target, origin=target.origin + 1))
    assert [one.name for one in tmp_path.iterdir()] == ["page.html"]
