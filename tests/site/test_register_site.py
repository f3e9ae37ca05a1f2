"""Sites of simulated scans in one frame, whatever stands among them."""

import time
from dataclasses import replace

import pytest
import torch
from determinism import threads
from problems import random_points, room_site, sphere_cloud
from sites import errors

import torchreg as tr
from torchreg.geometry.se3 import compose, inverse
from torchreg.site import SiteProgress


@pytest.fixture(scope="module")
def site():
    return room_site(4)


@pytest.fixture(scope="module")
def result(site):
    return tr.register_site(site.scans)


def same(one, other):
    """Whether two results have the same bits."""
    alike = [
        torch.equal(getattr(one, name).nan_to_num(-1), getattr(other, name).nan_to_num(-1))
        for name in ("T_world_scan", "group", "covariance", "center")
    ]
    transforms = [[each.link.T_target_source for each in result.links] for result in (one, other)]
    return all(alike) and torch.equal(*map(torch.stack, transforms)) and one.pairs == other.pairs


def test_scans_of_a_room_are_placed(site, result):
    assert result.group.tolist() == [0, 0, 0, 0]
    meters, degrees = errors(result.T_world_scan, site.T_world_scan)
    assert meters.max() < 0.01
    assert degrees.max() < 0.2
    assert result.reason == ("",) * 4
    assert torch.equal(result.T_world_scan[0], torch.eye(4, dtype=torch.float64))


def test_every_pair_is_tried_once_and_its_links_have_verdicts(result):
    assert sorted(tuple(sorted(pair[:2])) for pair in result.pairs) == [
        (i, j) for i in range(4) for j in range(i + 1, 4)
    ]
    assert sum(each.used for each in result.links) == 6
    assert all(each.loops == 2 for each in result.links if each.used)
    assert len(result.links) > 6  # second candidates are among them


def test_the_order_of_scans_changes_the_frame_alone(site, result):
    order = [2, 0, 3, 1]
    other = tr.register_site([site.scans[scan] for scan in order])
    back = inverse(result.T_world_scan[order[:1]])
    expected = compose(back, result.T_world_scan[order])
    assert other.group.tolist() == [0, 0, 0, 0]
    torch.testing.assert_close(other.T_world_scan, expected, rtol=0, atol=2e-5)


def test_threads_and_memory_change_no_bit(site, result):
    with threads(3):
        assert same(tr.register_site(site.scans), result)
    assert same(tr.register_site(tr.Clouds.pack(site.scans), max_bytes=1), result)


def test_scans_that_cannot_be_used_are_named_and_the_rest_goes_on(site):
    empty = site.scans[0].rows(torch.zeros(0, dtype=torch.int64), torch.tensor([0, 0]))
    large = replace(site.scans[1], points=1000 * site.scans[1].points, viewpoint=1000 * site.scans[1].viewpoint)
    other = replace(sphere_cloud(2000, dtype=torch.float32), normals=None)
    result = tr.register_site([site.scans[0], empty, site.scans[1], site.scans[0], large, site.scans[2], other])
    assert result.group.tolist() == [0, -1, 0, -1, -1, 0, -1]
    assert result.T_world_scan[result.group < 0].isnan().all()
    reasons = result.reason
    assert "too few points: the scan has 0" in reasons[1]
    assert reasons[3] == "a copy of scan 0"
    assert "units" in reasons[4]
    assert "1,000 times" in reasons[4]
    assert "no link is likely enough" in reasons[6] or "no pose to any other scan" in reasons[6]
    meters, _ = errors(result.T_world_scan[[0, 2, 5]], site.T_world_scan[:3])
    assert meters.max() < 0.01


def test_sites_without_a_pair_of_scans():
    scan = tr.Clouds(random_points(50))
    assert tr.register_site([scan]).reason == ("it is the only scan",)
    twice = tr.register_site([scan, scan])
    assert twice.reason == ("it is the only scan that can be used", "a copy of scan 0")


def test_a_scan_without_colors_is_placed_beside_colored_ones(site):
    result = tr.register_site([*site.scans[:2], replace(site.scans[2], colors=None)])
    assert result.group.tolist() == [0, 0, 0]
    assert any("no colors" in note for note in result.notes[2])
    assert not any("no colors" in note for note in result.notes[0])


def test_options_may_be_given_and_need_no_refinement(site):
    options = replace(tr.options_for(0.2), refine="none")
    result = tr.register_site(site.scans[:3], options)
    assert result.group.tolist() == [0, 0, 0]
    meters, _ = errors(result.T_world_scan, site.T_world_scan[:3])
    assert meters.max() < 0.1
    assert all(each.link.residual != each.link.residual for each in result.links)  # NaN: not refined


def test_progress_counts_every_step(site):
    seen: list[SiteProgress] = []
    tr.register_site(site.scans[:3], effort="fast", report=seen.append)
    assert {each.stage for each in seen} == {"describe", "register", "place", "refine"}
    last = {each.stage: each for each in seen}
    assert [last[name].done for name in ("describe", "register", "place")] == [3, 3, 3]
    assert all(each.done == each.total for each in last.values())


def test_no_time_is_counted_twice(site):
    begin = time.perf_counter()
    seconds = dict(tr.register_site(site.scans[:2], effort="fast").seconds)
    assert sum(seconds.values()) <= time.perf_counter() - begin
    assert {"looking", "registering pairs", "placing"} < set(seconds)


def test_arguments_are_checked(site):
    with pytest.raises(ValueError, match="scans: expected at least one cloud"):
        tr.register_site([])
    with pytest.raises(ValueError, match=r"effort: expected .*balanced"):
        tr.register_site(site.scans, effort="plain")
    with pytest.raises(ValueError, match=r"scans\[1\]: expected Clouds of one cloud"):
        tr.register_site([site.scans[0], tr.Clouds.pack(site.scans[:2])])


def test_the_summary_says_what_is_placed(site, result):
    assert result.summary().startswith("all 4 scans are placed in one frame")
    alone = tr.register_site(site.scans[:1]).summary()
    assert "none of 1 scans could be placed" in alone
    assert "it is the only scan" in alone
