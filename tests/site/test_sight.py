"""What scanners looked through: nothing under the true pose, much under a wrong one, the more the farther off."""

import torch
from problems import room_site

from torchreg.geometry.se3 import compose, inverse, rigid
from torchreg.geometry.small_motions import rotation_of
from torchreg.refinement.surfels import surfels_of
from torchreg.site.sight import Seen, seen_by, seen_through, sight_of


def sights(count=2):
    site = room_site(count, points=4000)
    return [sight_of(surfels_of(scan, 4000)) for scan in site.scans], site.T_world_scan


def shifted(x=0.0, degrees=0.0):
    turn = torch.tensor([0.0, 0.0, degrees], dtype=torch.float64).deg2rad()
    return rigid(rotation_of(turn), torch.tensor([x, 0.0, 0.0], dtype=torch.float64))


def test_the_true_pose_is_hardly_looked_through_and_others_are():
    (a, b), T = sights()
    true = compose(inverse(T[0]), T[1])
    right = seen_through(b, a, true)
    assert right < 0.05
    for wrong in (shifted(0.6), shifted(0.0, 30.0)):
        assert seen_through(b, a, compose(compose(inverse(T[0]), wrong), T[1])) > 3 * right


def test_both_directions_are_asked():
    (a, b), T = sights()
    pose = compose(compose(inverse(T[0]), shifted(0.5)), T[1])
    shares = seen_by(a, b, pose).share, seen_by(b, a, inverse(pose)).share
    assert seen_through(b, a, pose) == max(shares)
    assert seen_through(a, b, inverse(pose)) == seen_through(b, a, pose)


def test_a_hidden_scan_says_nothing():
    (a, b), _ = sights()
    far = rigid(torch.eye(3, dtype=torch.float64), torch.tensor([0.0, 0.0, 100.0], dtype=torch.float64))
    seen = seen_by(a, b, far)
    assert seen == Seen(0, 0)
    assert seen.share == 1 / 20


def test_scans_whose_scanner_is_not_known_have_no_sight():
    from dataclasses import replace

    scan = room_site(1).scans[0]
    assert sight_of(surfels_of(replace(scan, viewpoint=None), 500)) is None
    guessed = replace(scan, viewpoint_assumed=torch.tensor([True]))
    assert sight_of(surfels_of(guessed, 500)) is None
