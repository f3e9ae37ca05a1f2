"""What scanners looked through: nothing under the true pose, much under a wrong one, the more the farther off."""

import torch
from problems import room_site

from torchreg.geometry.se3 import compose, inverse, rigid
from torchreg.geometry.small_motions import rotation_of
from torchreg.refinement.surfels import surfels_of
from torchreg.site.sight import Stations, between, learned_stations, seen_by, sight_of, witnessed_by


def sights(count=2):
    site = room_site(count, points=12000)
    return [sight_of(surfels_of(scan, 4000)) for scan in site.scans], site.T_world_scan


def shifted(x=0.0, degrees=0.0):
    turn = torch.tensor([0.0, 0.0, degrees], dtype=torch.float64).deg2rad()
    return rigid(rotation_of(turn), torch.tensor([x, 0.0, 0.0], dtype=torch.float64))


def test_scanners_speak_for_the_true_pose_and_against_others():
    (a, b), T = sights()
    right = witnessed_by(b, a, compose(inverse(T[0]), T[1]))
    assert right > 0.0
    for wrong in (shifted(0.6), shifted(0.0, 30.0)):
        assert witnessed_by(b, a, compose(compose(inverse(T[0]), wrong), T[1])) < right - 1.0


def test_what_is_looked_through_grows_with_the_error():
    (a, b), T = sights()
    shares = [seen_by(a, b, compose(compose(inverse(T[0]), shifted(x)), T[1])).share for x in (0.0, 0.4, 0.8)]
    assert shares == sorted(shares)
    assert shares[0] < 0.05


def test_roles_do_not_matter():
    (a, b), T = sights()
    pose = compose(compose(inverse(T[0]), shifted(0.5)), T[1])
    one, other = witnessed_by(b, a, pose), witnessed_by(a, b, inverse(pose))
    assert abs(one - other) < 1e-9


def test_other_colors_speak_against_a_pose():
    (a, b), T = sights()
    pose = compose(inverse(T[0]), T[1])
    shuffled = torch.randperm(len(b.points), generator=torch.Generator().manual_seed(0))
    painted = b._replace(colors=b.colors[shuffled])
    brighter = b._replace(colors=b.colors + 0.1)
    right = witnessed_by(b, a, pose)
    assert witnessed_by(painted, a, pose) < right - 1.0
    assert abs(witnessed_by(brighter, a, pose) - right) < 1e-6
    assert witnessed_by(b._replace(colors=None), a, pose) <= right


def test_scanners_at_one_place_are_doubted_as_the_site_teaches():
    (a, b), T = sights()
    same, apart = torch.eye(4, dtype=torch.float64), compose(inverse(T[0]), T[1])
    assert between(a, a, same) == 0
    assert between(b, a, apart) == between(a, b, inverse(apart)) > 0
    far, near = learned_stations([1.5] * 20), learned_stations([0.01] * 20)
    assert far.odds(0.1) < Stations().odds(0.1) - 1.0  # a survey whose stations stand far apart
    assert near.odds(0.1) == 0.0 > near.odds(0.0)  # a camera that was carried about
    assert learned_stations([1.5] * 9) is None


def test_a_hidden_scan_says_nothing():
    (a, b), _ = sights()
    far = rigid(torch.eye(3, dtype=torch.float64), torch.tensor([0.0, 0.0, 100.0], dtype=torch.float64))
    assert witnessed_by(b, a, far) == 0.0


def test_scans_whose_scanner_is_not_known_have_no_sight():
    from dataclasses import replace

    scan = room_site(1, points=12000).scans[0]
    assert sight_of(surfels_of(replace(scan, viewpoint=None), 4000)) is None
    guessed = replace(scan, viewpoint_assumed=torch.tensor([True]))
    assert sight_of(surfels_of(guessed, 4000)) is None
    assert sight_of(surfels_of(scan, 500)) is None  # too few
    assert sight_of(surfels_of(scan, 4000)) is not None
