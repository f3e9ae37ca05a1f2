"""Which pairs of a large site are asked: those that promise most, then what is loose or hangs by a thread."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from problems import numbers, room_site

import torchreg as tr
from torchreg.geometry.se3 import compose, inverse
from torchreg.registration.describe import describe_clouds
from torchreg.site.pairs import ALL_SCANS
from torchreg.site.rounds import Standing, first_pairs, most_pairs, next_pairs, overlaps
from torchreg.site.sketches import POINTS, Sketch, sketch_of, votes


def made_votes(count, seed=0):
    upper = numbers(count, count, seed=seed).abs().triu(diagonal=1)
    return upper + upper.t()


def standing(group, tried=(), holding=(), T=None):
    poses = torch.eye(4, dtype=torch.float64).repeat(len(group), 1, 1) if T is None else T
    return Standing(torch.tensor(group), poses, frozenset(tried), frozenset(holding))


def lone_points(count):
    """Sketches that overlap none of the others."""
    return [
        Sketch(torch.tensor([[100.0 * k, 0.0, 0.0]], dtype=torch.float64), torch.zeros(1, 3), 0.1) for k in range(count)
    ]


@given(count=st.integers(2, 30), seed=st.integers(0, 10))
def test_first_pairs_give_every_scan_its_best_partners(count, seed):
    votes = made_votes(count, seed)
    pairs = first_pairs(votes)
    assert len(set(pairs)) == len(pairs)
    assert all(0 <= a < b < count for a, b in pairs)
    values = [float(votes[pair]) for pair in pairs]
    assert values == sorted(values, reverse=True)
    for scan in range(count):
        others = [other for other in range(count) if other != scan]
        best = max(others, key=lambda other: float(votes[scan, other]))
        assert (min(scan, best), max(scan, best)) in pairs


def test_loose_scans_and_groups_are_asked_for():
    votes = made_votes(8)
    pairs = next_pairs(votes, lone_points(8), standing([0, 0, 0, 0, 1, 1, -1, 0], tried=[(0, 1)]))
    assert any(6 in pair for pair in pairs)
    assert any(len({4, 5} & set(pair)) == 1 and 6 not in pair for pair in pairs)
    assert (0, 1) not in pairs


def test_both_sides_of_a_thread_are_asked_for():
    ring = [(0, 1), (1, 2), (0, 2)]
    other = [(3, 4), (4, 5), (3, 5)]
    held = [*ring, *other, (2, 3)]
    pairs = next_pairs(made_votes(6), lone_points(6), standing([0] * 6, tried=held, holding=held))
    assert pairs
    assert all((a in (0, 1, 2)) != (b in (0, 1, 2)) for a, b in pairs)
    whole = [*held, (0, 4)]
    assert next_pairs(made_votes(6), lone_points(6), standing([0] * 6, tried=whole, holding=whole)) == []


def test_scans_that_overlap_under_the_poses_are_asked_for():
    grid = torch.cartesian_prod(*[torch.arange(6, dtype=torch.float64)] * 2)
    plane = torch.cat([grid, torch.zeros(36, 1, dtype=torch.float64)], dim=1) + 0.5
    sketches = [Sketch(plane, torch.zeros(36, 3), 1.0)] * 3
    T = torch.eye(4, dtype=torch.float64).repeat(3, 1, 1)
    T[1, 0, 3] = 3.0  # half of it
    T[2, 0, 3] = 60.0
    now = standing([0, 0, 0], tried=[(0, 2)], holding=[(0, 2)], T=T)
    share = overlaps(sketches, now)
    torch.testing.assert_close(share[0, 1], torch.tensor(0.5, dtype=torch.float64))
    assert share[0, 2] == share[1, 2] == 0
    assert (0, 1) in next_pairs(torch.zeros(3, 3, dtype=torch.float64), sketches, now)
    apart = standing([0, 1, 0], T=T)
    assert overlaps(sketches, apart)[0, 1] == 0


@pytest.mark.parametrize("count", [2, 20, 32, 60, 300])
def test_a_share_of_the_pairs_of_large_sites_is_asked(count):
    every = count * (count - 1) // 2
    assert most_pairs(count) == (every if count <= ALL_SCANS else max(2016, int(0.2 * every)))
    assert most_pairs(300) < 300 * 299 / 2 / 4


def test_sketches_of_overlapping_scans_agree_and_of_others_do_not():
    rooms = room_site(2)
    other = torch.rand(3000, 3, generator=torch.Generator().manual_seed(1)) * 5
    clouds = [*rooms.scans, tr.Clouds(other, colors=torch.rand(3000, 3, generator=torch.Generator().manual_seed(2)))]
    options = tr.options_for(0.2)
    sketches = [sketch_of(describe_clouds(cloud, options), options, colored=True) for cloud in clouds]
    assert all(len(sketch.points) <= POINTS for sketch in sketches)
    same = votes(sketches[0], sketches[1], 0.3)
    assert same > 3 * max(votes(sketches[0], sketches[2], 0.3), 1.0)
    moved = sketches[1]._replace(points=sketches[1].points + 7.0)
    assert votes(sketches[0], moved, 0.3) == pytest.approx(same, rel=0.05)


def test_poses_move_what_overlaps():
    rooms = room_site(2)
    options = tr.options_for(0.2)
    sketches = [sketch_of(describe_clouds(cloud, options), options, colored=True) for cloud in rooms.scans]
    T = rooms.T_world_scan
    true = overlaps(sketches, standing([0, 0], T=T))[0, 1]
    assert true > 0.5
    away = T.clone()
    away[1, 0, 3] += 50
    assert overlaps(sketches, standing([0, 0], T=away))[0, 1] == 0
    turned = torch.stack([compose(inverse(T[0]), pose) for pose in T])
    assert abs(overlaps(sketches, standing([0, 0], T=turned))[0, 1] - true) < 0.3
