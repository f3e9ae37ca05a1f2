"""Scanners that saw each other's surfaces: what joins by their word, and what they are asked of a site."""

import math

import pytest
import torch
from problems import room_site
from sites import made_poses, right_link

import torchreg as tr
from torchreg.geometry.se3 import apply, compose, inverse
from torchreg.site import trust
from torchreg.site.panorama import Compared, Neutral, learned_neutral, panorama_of
from torchreg.site.placement import place
from torchreg.site.site_sight import SiteSight

DOUBT = 3.0


class Witnesses(SiteSight):
    """Scanners that know the truth and speak for it and against all else; of the last scan they say ``word``."""

    def __init__(self, poses, word):
        super().__init__(lambda scan: None, len(poses))
        self.poses, self.word = poses, word

    def has(self, node):
        return node < len(self.poses)

    def scanner(self, scan):
        return torch.zeros(3, dtype=torch.float64)

    def odds(self, source, target, T):
        true = compose(inverse(self.poses[target]), self.poses[source])
        right = float(torch.linalg.vector_norm(apply(T, true[None, :3, 3]) - apply(true, true[None, :3, 3]))) < 0.5
        word = self.word if len(self.poses) - 1 in (source, target) else 1.0
        return word if right else -word


def joined(word, *, pairs=2, doubt=DOUBT, raw=2.0):
    """Whether a scan joins eight others by links of log-odds ``raw`` that were doubted."""
    poses, generator = made_poses(9, spacing=3.0), torch.Generator().manual_seed(0)
    sure = [right_link(poses, (a, a + 1), generator, log_odds=6.0) for a in range(7)]
    doubted = [right_link(poses, (a, 8), generator, log_odds=raw - DOUBT) for a in range(3, 3 + pairs)]
    sight = None if word is None else Witnesses(poses, word)
    group = place(sure + doubted, 9, sight=sight, doubt=doubt).group.tolist()
    assert group[:8] == [0] * 8
    return group[8] == 0


def test_doubted_links_that_agree_join_a_scan_that_scanners_speak_for():
    assert joined(1.0)
    assert not joined(1.0, doubt=0.0)  # nothing was doubted: these log-odds are all there is


@pytest.mark.parametrize("case", [{"word": None}, {"word": 0.0}, {"word": -2.0}], ids=str)
def test_without_their_word_it_stays_apart(case):
    assert not joined(**case)


def test_a_single_pair_is_not_enough_nor_are_links_that_were_unlikely_before():
    assert not joined(1.0, pairs=1)
    assert not joined(1.0, raw=-1.0)


def seen(through, color=0.03, tint=0.01):
    return Compared(through, color, tint, 0.0, 0.0)


def test_what_is_usual_on_a_site_does_not_speak_against_its_poses():
    usual = [seen(0.02 + 0.001 * k, 0.08, 0.02) for k in range(10)]
    learned = learned_neutral(usual)
    assert sum(learned.odds(one) >= 0 for one in usual) >= 9
    assert all(Neutral().odds(one) < 0 for one in usual)
    assert learned.odds(seen(0.2, 0.08, 0.02)) < 0


def test_neutral_points_are_never_stricter_than_usual_nor_without_bound():
    assert learned_neutral([seen(0.0, 0.0, 0.0)] * 5) == Neutral()
    assert learned_neutral([seen(1.0, 1.0, 1.0)] * 5).through < 0.1
    assert learned_neutral([seen(math.nan, math.nan, math.nan)] * 5) == Neutral()
    assert learned_neutral([seen(0.02)] * 2) is None


@pytest.fixture(scope="module")
def cameras():
    """Scans of a room of which each shows a small part, and their poses."""
    site = room_site(4, points=12000)
    return [_part(scan) for scan in site.scans], site.scans, site.T_world_scan


def _part(cloud):
    away = cloud.points - cloud.viewpoint
    keep = (away / torch.linalg.vector_norm(away, dim=1, keepdim=True))[:, 0] > 0.2
    rows = keep.nonzero()[:, 0]
    return tr.Clouds(cloud.points[rows], colors=cloud.colors[rows], viewpoint=cloud.viewpoint)


def test_cameras_show_a_part_of_the_sphere_and_scanners_nearly_all(cameras):
    parts, whole, _ = cameras
    assert not any(panorama_of(one).is_around for one in parts)
    assert all(panorama_of(one).is_around for one in whole)


@pytest.mark.parametrize("around", [False, True])
def test_only_sites_of_cameras_tell_what_is_usual(cameras, around, monkeypatch):
    parts, whole, poses = cameras
    panoramas = [panorama_of(one) for one in (whole if around else parts)]
    sight, generator = SiteSight(lambda scan: panoramas[scan], 4), torch.Generator().manual_seed(0)
    asked = []
    monkeypatch.setattr(trust, "learned_neutral", lambda seen: asked.append(len(seen)))
    links = [right_link(poses, (a, b), generator, log_odds=5.0) for b in range(4) for a in range(b)]
    trust.placed([[link] for link in links], 4, trust.Tolerance(), sight)
    assert asked == ([] if around else [6])


@pytest.mark.parametrize("count", [3, 5, 8])
def test_of_few_links_all_speak_for_themselves(count):
    usual = [seen(0.01 + 0.002 * k) for k in range(count)]
    learned = learned_neutral(usual)
    assert all(learned.odds(one) >= 0 for one in usual)
