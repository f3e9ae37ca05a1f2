"""Sites with known truth: wrong links, look-alike floors, second candidates, groups apart, and nothing at all."""

import math
from dataclasses import replace

import pytest
import torch
from closeness import close
from determinism import THREADS, same_bits
from problems import seeded, turned
from refusals import refuses
from sites import errors, link_of, look_alike_site, made_poses, made_site, right_link, wrong_link

from torchreg.geometry.se3 import compose, inverse
from torchreg.site import KnownPose, loose_covariance, place


def assert_right(placement, truth, meters=0.1):
    """All scans are placed in one frame, and none is off."""
    assert placement.group.tolist() == [0] * len(truth)
    assert float(errors(placement.T_world_scan, truth)[0].max()) < meters


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("wrong", [0.0, 0.1, 0.2, 0.3])
def test_wrong_links_are_told_from_right_ones(wrong, seed):
    site = made_site(40, 160, wrong, seed)
    placement = place(site.links, 40)
    assert_right(placement, site.poses)
    assert placement.used.tolist() == site.right
    assert placement.reason == ("",) * 40


@pytest.mark.parametrize("seed", range(2))
def test_where_every_second_link_is_wrong_no_scan_is_off_and_few_are_left_out(seed):
    site = made_site(40, 200, 0.5, seed)
    placement = place(site.links, 40)
    placed = placement.group == 0
    assert int(placed.sum()) >= 38
    assert float(errors(placement.T_world_scan[placed], site.poses[placed])[0].max()) < 0.1


@pytest.mark.slow
def test_five_hundred_scans():
    site = made_site(500, 5000, 0.2)
    placement = place(site.links, 500)
    assert_right(placement, site.poses)
    assert placement.used.tolist() == site.right


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_many_links_between_look_alike_floors_do_not_outvote_a_few_right_ones(seed):
    site = look_alike_site(60, 300, alike=80, between=6, seed=seed)
    placement = place(site.links, 60)
    assert_right(placement, site.poses)
    assert not bool(placement.used[~torch.tensor(site.right)].any())


def test_floors_are_left_apart_rather_than_joined_against_a_much_likelier_link():
    site = look_alike_site(40, 200, alike=60, between=1, seed=0, floors=2, odds=7.0)
    placement = place(site.links, 40)
    assert sorted(torch.bincount(placement.group).tolist()) == [20, 20]


def test_a_second_candidate_that_loops_confirm_replaces_the_first():
    site = made_site(20, 80, 0.0)
    generator = seeded(1)
    first = [wrong_link((one.target, one.source), generator, 0.2, probability=0.5) for one in site.links[::5]]
    second = [replace(one, log_odds=-0.1, probability=0.4, rank=1) for one in site.links[::5]]
    kept = [one for number, one in enumerate(site.links) if number % 5]
    placement = place(first + second + kept, 20)
    assert_right(placement, site.poses)
    assert placement.used.tolist() == [False] * len(first) + [True] * (len(second) + len(kept))


def test_a_scan_with_doubted_links_alone_is_placed_where_they_agree():
    site = made_site(20, 80, 0.0)
    last = 19
    doubted = [
        replace(one, log_odds=-0.4, probability=0.4, reason="ambiguous") if last in (one.target, one.source) else one
        for one in site.links
    ]
    assert sum(1 for one in doubted if one.reason) >= 3
    assert_right(place(doubted, 20), site.poses)


def test_a_scan_that_nothing_holds_is_left_out_by_name():
    site = made_site(12, 40, 0.0)
    refused = wrong_link((3, 12), seeded(), -3.0, reason="little overlap")
    placement = place([*site.links, refused], 14)
    assert placement.group.tolist() == [0] * 12 + [-1, -1]
    assert "scan 3" in placement.reason[12]
    assert "little overlap" in placement.reason[12]
    assert "no pose to any other scan" in placement.reason[13]
    for values in (placement.T_world_scan, placement.covariance, placement.center):
        assert bool(torch.isnan(values[12:]).all())
        assert not bool(torch.isnan(values[:12]).any())
    assert not bool(placement.used[-1])
    assert math.isnan(placement.meters[-1])


def test_a_chain_is_held_by_single_links():
    poses = made_poses(8)
    chain = [right_link(poses, (k, k + 1), seeded(k), 1.0) for k in range(7)]
    placement = place(chain, 8)
    assert_right(placement, poses)
    assert placement.loops.tolist() == [0] * 7
    assert close(placement.meters, torch.zeros(7, dtype=torch.float64), 1e-9)
    spread = placement.covariance.diagonal(dim1=1, dim2=2).sum(1)
    assert spread[0] == 0
    assert bool((spread.diff() > 0).all())


@pytest.mark.parametrize("seed", range(2))
def test_errors_that_add_up_around_a_large_loop_do_not_keep_it_open(seed):
    count, reach = 60, 40.0
    angle = torch.arange(count, dtype=torch.float64) * (2 * math.pi / count)
    poses = made_poses(count)
    poses[:, :3, 3] = torch.stack([reach * angle.cos(), reach * angle.sin(), torch.zeros_like(angle)], dim=1)
    generator = seeded(seed)
    links = [
        right_link(poses, (k, (k + step) % count), generator, 3.0 + step, noise=12.0)
        for k in range(count)
        for step in (1, 2)
    ]
    placement = place(links, count)
    assert bool(placement.used.all())
    assert float(errors(placement.T_world_scan, poses)[0].max()) < 2.0
    assert placement.scale > 30


def test_groups_that_do_not_connect_stay_apart():
    site = made_site(20, 80, 0.0)
    apart = [one for one in site.links if (one.target < 8) == (one.source < 8)]
    placement = place(apart, 20)
    assert placement.group.tolist() == [1] * 8 + [0] * 12
    for part in (slice(0, 8), slice(8, 20)):
        assert float(errors(placement.T_world_scan[part], site.poses[part])[0].max()) < 0.1
    assert close(placement.T_world_scan[[0, 8]], torch.eye(4, dtype=torch.float64).expand(2, 4, 4), 0)


def test_two_that_contradict_each_other_place_nobody():
    generator = seeded()
    placement = place([wrong_link((0, 1), generator, 2.0) for _ in range(2)], 2)
    assert placement.group.tolist() == [-1, -1]
    assert "contradict" in placement.reason[0]


def test_no_links_and_one_scan():
    assert place([], 0).group.tolist() == []
    assert place([], 1).reason == ("it is the only scan",)
    nobody = place([], 3)
    assert nobody.group.tolist() == [-1] * 3
    assert all("no pose" in reason for reason in nobody.reason)


def test_the_order_of_links_changes_no_bit_of_the_poses():
    site = made_site(30, 120, 0.3)
    placement = place(site.links, 30)
    order = torch.randperm(120, generator=seeded()).tolist()
    other = place([site.links[k] for k in order], 30)
    assert same_bits(placement.T_world_scan, other.T_world_scan)
    assert same_bits(placement.covariance, other.covariance)
    assert same_bits(placement.weight[order], other.weight)


def test_threads_change_no_bit():
    site = made_site(30, 120, 0.3)
    alone = place(site.links, 30)
    threads = torch.get_num_threads()
    try:
        for number in THREADS:
            torch.set_num_threads(number)
            assert same_bits(place(site.links, 30), alone)
    finally:
        torch.set_num_threads(threads)


def test_the_numbers_of_scans_change_nothing_but_the_frame():
    site = made_site(30, 120, 0.2)
    new = torch.randperm(30, generator=seeded()).tolist()
    placement = place(site.links, 30)
    other = place([replace(one, target=new[one.target], source=new[one.source]) for one in site.links], 30)
    assert placement.used.tolist() == other.used.tolist()
    renamed = other.T_world_scan[new]
    assert close(compose(inverse(renamed[0]), renamed), placement.T_world_scan, 1e-6)


def test_swapped_ends_change_nothing():
    site = made_site(20, 80, 0.2)
    swapped = []
    for one in site.links:
        back = inverse(one.T_target_source)
        both = torch.block_diag(back[:3, :3], back[:3, :3])
        swapped.append(
            replace(
                one,
                target=one.source,
                source=one.target,
                T_target_source=back,
                covariance=both @ one.covariance @ both.t(),
                center=back[:3, :3] @ one.center + back[:3, 3],
            )
        )
    one, other = place(site.links, 20), place(swapped, 20)
    assert one.used.tolist() == other.used.tolist()
    assert close(one.T_world_scan, other.T_world_scan, 1e-6)


def known(poses, scan, deviation=0.002, T=None):
    T_world = poses[scan] if T is None else compose(T, poses[scan])
    return KnownPose(scan=scan, T_world_scan=T_world, covariance=loose_covariance(deviation, 5.0))


def test_a_known_pose_gives_the_frame_far_from_its_zero():
    site = made_site(20, 80, 0.0)
    T = turned(30, (0, 0, 1), (5e5, 4.5e6, 300.0))
    placement = place(site.links, 20, known=[known(site.poses, 4, T=T), known(site.poses, 11, T=T)])
    assert placement.group.tolist() == [0] * 20
    assert bool(placement.in_world.all())
    places = compose(T, site.poses)
    assert close(placement.T_world_scan[:, :3, 3], places[:, :3, 3], 0.05)
    assert float(placement.covariance.diagonal(dim1=1, dim2=2).min()) > 0


def test_known_poses_join_groups_and_place_scans_without_links():
    site = made_site(20, 80, 0.0)
    apart = [one for one in site.links if (one.target < 8) == (one.source < 8)]
    placement = place(apart, 21, known=[known(torch.cat([site.poses, site.poses[:1]]), scan) for scan in (2, 15, 20)])
    assert placement.group.tolist() == [0] * 21
    assert close(placement.T_world_scan[:20, :3, 3], site.poses[:, :3, 3], 0.1)


def test_known_poses_pull_by_their_covariance():
    poses = made_poses(2)
    link = link_of((0, 1), compose(inverse(poses[0]), poses[1]), 4.0)
    moved = turned(0, (0, 0, 1), (0.02, 0.0, 0.0))
    placement = place([link], 2, known=[known(poses, 0, 0.001), known(poses, 1, 0.03, T=moved)])
    shift = placement.T_world_scan[:, 0, 3] - poses[:, 0, 3]
    assert float(shift[0].abs()) < 1e-4
    assert 0 < float(shift[1]) < 0.002


def test_errors_of_links_are_told_in_meters_and_degrees():
    site = made_site(20, 80, 0.0)
    first = site.links[0]
    moved = compose(turned(2, (0, 1, 0)), compose(turned(0, (0, 0, 1), (0.1, 0.0, 0.0)), first.T_target_source))
    wrong = replace(first, T_target_source=moved, center=torch.zeros(3, dtype=torch.float64))
    placement = place([wrong, *site.links[1:]], 20)
    assert 0.08 < float(placement.meters[0]) < 0.12
    assert 1.9 < float(placement.degrees[0]) < 2.1
    assert float(placement.weight[0]) < 0.01
    assert float(placement.meters[1:].max()) < 0.03


def test_loops_are_counted():
    poses = made_poses(3)
    ring = [link_of(pair, compose(inverse(poses[pair[0]]), poses[pair[1]]), 2.0) for pair in ((0, 1), (1, 2), (2, 0))]
    placement = place(ring, 3)
    assert placement.loops.tolist() == [1, 1, 1]
    assert close(placement.loop_meters, torch.zeros(3, dtype=torch.float64), 1e-9)
    assert close(placement.loop_degrees, torch.zeros(3, dtype=torch.float64), 1e-6)


def test_a_scan_that_there_is_not_is_refused():
    poses = made_poses(5)
    link = right_link(poses, (0, 1), seeded())
    with refuses("links[0].source", "below 1", "1"):
        place([link], 1)
    with refuses("known[0].scan", "below 1", "4"):
        place([], 1, known=[known(poses, 4)])
    with refuses("count", "-1"):
        place([], -1)
