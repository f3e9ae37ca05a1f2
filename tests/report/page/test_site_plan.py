"""The plan of a site: every scan and link is there, floors apart, and nothing lies on another."""

import itertools
import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
import torch
from pages import Page
from problems import seeded, turned
from sites import link_of, right_link

import torchreg as tr
from torchreg.geometry.se3 import compose, inverse, rigid
from torchreg.report.page.site_frame import group_frame
from torchreg.report.page.site_plan import site_plan
from torchreg.report.page.site_report import site_report_html
from torchreg.report.site_text import doubts
from torchreg.site import SiteLink, SiteResult, TriedPair


def hall(places, seed=0):
    """Scans of a floor and walls about each place (x, y, z), in turned frames, upright."""
    draw = np.random.default_rng(seed)
    scans, poses = [], []
    for k, place in enumerate(places):
        points = draw.uniform((-6, -4, -1.5), (6, 4, 1.2), (3000, 3))
        points[:1500, 2] = -1.5
        points[1500:, 1] = np.sign(points[1500:, 1]) * 4
        pose = turned(25.0 * k, (0, 0, 1), place)
        local = points @ pose[:3, :3].numpy()
        zero = torch.zeros(1, 3)
        scans.append(
            tr.Clouds(torch.from_numpy(local).float(), viewpoint=zero, viewpoint_assumed=torch.tensor([False]))
        )
        poses.append(pose)
    return scans, torch.stack(poses)


def site_of(poses, links, group=None, pairs=(), used=None):
    count = len(poses)
    judged = [
        SiteLink(link, used is None or used[k], 1.0, 0.002, 0.01, k % 2, 0.003, 0.02) for k, link in enumerate(links)
    ]
    covariance = (torch.eye(6, dtype=torch.float64) * 1e-6).repeat(count, 1, 1)
    return SiteResult(
        T_world_scan=poses,
        group=torch.zeros(count, dtype=torch.int64) if group is None else torch.tensor(group),
        covariance=covariance,
        center=poses[:, :3, 3].clone(),
        reason=tuple("" if group is None or group[k] >= 0 else "too few points" for k in range(count)),
        notes=((),) * count,
        links=tuple(judged),
        pairs=tuple(pairs),
        scale=1.0,
        doubt=0.0,
        control=(),
        remarks=(),
        seconds=(),
    )


def linked(poses, pairs, **more):
    generator = seeded()
    return [
        right_link(poses, pair, generator, residual=0.001 * (k + 1), overlap=0.5, **more)
        for k, pair in enumerate(pairs)
    ]


class Drawing(HTMLParser):
    """The circles of scans by their number, and the titles with the class of what they are in."""

    def __init__(self, markup):
        super().__init__()
        self.circles, self.titles, self.groups, self.last, self.tag = {}, [], [], None, ""
        self.feed(markup)

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.tag = tag
        if tag == "g":
            self.groups.append(attrs.get("class") or "")
        if tag == "circle" and "fill" in attrs:
            self.last = float(attrs["cx"]), float(attrs["cy"]), float(attrs["r"])

    def handle_endtag(self, tag):
        if tag == "g":
            self.groups.pop()

    def handle_data(self, data):
        if self.tag == "title":
            self.titles.append((next(name for name in reversed(self.groups) if name), data))
        elif self.tag == "text" and self.groups and self.groups[-1].startswith("scan"):
            self.circles[int(data)] = self.last
        self.tag = ""


def drawn(site, scans, missing=()):
    names = [f"<{k}>.ply" for k in range(len(scans))]
    markup = site_plan(site, group_frame(site, scans, 0), scans, names, missing)
    Page(markup)  # closes what it opens
    return Drawing(markup), markup


def test_every_scan_link_and_refused_pair_is_there_with_its_words():
    scans, poses = hall([(0, 0, 0), (4, 0, 0), (8, 1, 0), (12, 0, 0)])
    pairs = [(0, 1), (1, 2), (2, 3), (0, 2)]
    tried = [TriedPair(s, t, True, "", 1) for t, s in pairs] + [TriedPair(3, 0, False, "few <points> overlap", 2)]
    drawing, markup = drawn(site_of(poses, linked(poses, pairs), pairs=tried), scans)
    assert sorted(drawing.circles) == [0, 1, 2, 3]
    used = [text for kind, text in drawing.titles if kind == "used"]
    assert len(used) == 4
    assert any("scans 1 and 0" in text and "residual 1.0 mm" in text for text in used)
    (refused,) = [text for kind, text in drawing.titles if kind == "refused"]
    assert "scans 3 and 0, no link: few <points> overlap." in refused
    assert "<points>" not in markup
    assert "<0>" not in markup
    assert len(set(re.findall(r'stroke="(#\w{6})"', markup))) == 4  # residuals differ


@pytest.mark.parametrize("count", [3, 40, 150])
def test_no_scan_hides_another_even_at_one_place(count):
    scans, poses = hall([(0.001 * k, 0, 0) for k in range(count)])
    drawing, _ = drawn(site_of(poses, []), scans)
    assert len(drawing.circles) == count
    for (x1, y1, r1), (x2, y2, r2) in itertools.combinations(drawing.circles.values(), 2):
        assert math.hypot(x2 - x1, y2 - y1) >= r1 + r2 - 0.2


def test_floors_stand_one_above_another():
    grid = [(4 * x, 0, 3.0 * floor) for floor in range(3) for x in range(4)]
    scans, poses = hall([*grid, (5, 1, 1.5)])  # the last on the stairs
    drawing, markup = drawn(site_of(poses, []), scans)
    heights = np.array([drawing.circles[k][1] for k in range(12)]).reshape(3, 4)
    assert heights[0].min() > heights[1].max() >= heights[1].min() > heights[2].max()
    assert "3.0 m higher" in markup
    assert "6.0 m higher" in markup


@pytest.mark.parametrize("rise", [0.1, 0.8, 1.5])
def test_rising_ground_has_no_floors(rise):
    scans, poses = hall([(4 * x, y, rise * x) for x in range(8) for y in (0, 2)])
    assert "higher" not in drawn(site_of(poses, []), scans)[1]


def test_the_shape_of_the_plan_is_that_of_the_site_turned_to_its_walls():
    places = [(0, 0, 0), (10, 0, 0), (20, 0, 0), (30, 8, 0)]
    scans, poses = hall(places)
    turn = turned(33)
    poses = compose(turn[None].expand(4, 4, 4), poses)
    poses = compose(inverse(poses[0])[None].expand(4, 4, 4), poses)
    drawing, _ = drawn(site_of(poses, []), scans)
    shown = np.array([drawing.circles[k][:2] for k in range(4)])
    true = np.array(places)[:, :2]
    ratio = np.linalg.norm(shown[1:] - shown[0], axis=1) / np.linalg.norm(true[1:] - true[0], axis=1)
    assert np.ptp(ratio) < 0.02 * ratio.mean()
    assert abs(shown[1, 1] - shown[0, 1]) < 0.2 * abs(shown[1, 0] - shown[0, 0])  # along the page


def test_scans_that_are_not_placed_stand_below_with_their_reason():
    scans, poses = hall([(0, 0, 0), (4, 0, 0), (8, 1, 0)])
    gone = poses.clone()
    gone[2] = torch.nan
    pairs = [TriedPair(2, 0, False, "no overlap", 1)]
    site = site_of(gone, linked(poses, [(0, 1)]), group=[0, 0, -1], pairs=pairs)
    drawing, _ = drawn(site, scans, missing=[2])
    assert drawing.circles[2][1] > max(drawing.circles[0][1], drawing.circles[1][1])
    assert any("not placed: too few points" in text for _, text in drawing.titles)
    assert any("no overlap" in text for kind, text in drawing.titles if kind == "refused")


def test_many_scans_that_are_not_placed_stand_in_rows():
    scans, poses = hall([(0, 0, 0), (4, 0, 0)])
    empty = tr.Clouds(torch.zeros(0, 3))
    gone = torch.cat([poses, torch.full((150, 4, 4), torch.nan, dtype=torch.float64)])
    drawing, _ = drawn(site_of(gone, [], group=[0, 0] + [-1] * 150), [*scans, *[empty] * 150], missing=range(2, 152))
    assert len(drawing.circles) == 152
    for (x1, y1, r1), (x2, y2, r2) in itertools.combinations(drawing.circles.values(), 2):
        assert math.hypot(x2 - x1, y2 - y1) >= r1 + r2


def test_the_table_tells_where_a_link_is_weak():
    scans, poses = hall([(0, 0, 0), (4, 0, 0)])
    T = compose(inverse(poses[0]), poses[1])
    weak = torch.tensor([1e-8, 1e-8, 1e-8, 1e-4, 4e-6, 9e-6], dtype=torch.float64).diag()
    link = replace(link_of((0, 1), T, 4.0), covariance=weak)
    text = Page(site_report_html(site_of(poses, [link]), scans)).text("td")
    assert "10, 2.0, 3.0 mm" in text


def test_what_to_look_at_first_names_bridges_pulling_links_and_loose_scans():
    _, poses = hall([(4 * k, 0, 0) for k in range(7)])
    pairs = [(0, 1), (1, 2), (0, 2), (2, 3), (3, 4), (4, 5), (3, 5), (5, 6)]
    site = site_of(poses, linked(poses, pairs))
    lines = doubts(site)
    assert any(line.startswith("3 scans, scan 2 among them, hang by one link, to scan 3") for line in lines)
    assert any(line.startswith("scan 6 hangs by one link, to scan 5") for line in lines)
    links = list(site.links)
    links[1] = links[1]._replace(meters=0.5)
    covariance = site.covariance.clone()
    covariance[4] *= 400
    lines = doubts(replace(site, links=tuple(links), covariance=covariance))
    assert any("scan 2 and scan 1 is off by 0.5 m, most by 2.0 mm" in line for line in lines)
    assert any(line.startswith("scan 4 is held loosely: its place is known to 35 mm") for line in lines)
    assert not any("pulls" in line or "loosely" in line for line in doubts(site))


def test_rigid_motion_of_the_site_keeps_the_frame_small():
    scans, poses = hall([(0, 0, 0), (4, 0, 0)])
    far = rigid(torch.eye(3, dtype=torch.float64), torch.tensor([5e5, 5.4e6, 100.0], dtype=torch.float64))
    near, moved = (group_frame(site_of(T, []), scans, 0) for T in (poses, compose(far[None].expand(2, 4, 4), poses)))
    np.testing.assert_allclose(near.scanners, moved.scanners, atol=1e-6)
