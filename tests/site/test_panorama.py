"""What scanners saw all around: for poses known to centimeters, looked up by direction."""

from dataclasses import replace

import pytest
import torch
from problems import room_site

from torchreg.geometry.se3 import compose, inverse, rigid
from torchreg.geometry.small_motions import rotation_of
from torchreg.site.panorama import Neutral, compared, looked, panorama_of
from torchreg.site.panorama_file import panorama_file, read_panorama, write_panorama
from torchreg.site.sight import learned_stations
from torchreg.site.site_sight import SiteSight


@pytest.fixture(scope="module")
def room():
    site = room_site(2, points=12000)
    return site.scans, compose(inverse(site.T_world_scan[0]), site.T_world_scan[1])  # T_first_second


def moved(x=0.0, degrees=0.0):
    turn = torch.tensor([0.0, 0.0, degrees], dtype=torch.float64).deg2rad()
    return rigid(rotation_of(turn), torch.tensor([x, 0.0, 0.0], dtype=torch.float64))


def looked_at(source, target, T_target_source):
    return Neutral().odds(compared(source, target, T_target_source))


def test_scanners_speak_for_a_pose_that_is_nearly_right_and_against_wrong_ones(room):
    (one, other), T = room
    a, b = panorama_of(one), panorama_of(other)
    right = looked_at(b, a, compose(T, moved(0.03, 0.2)))
    assert right > 0.0
    for wrong in (moved(0.6), moved(0.0, 30.0)):
        assert looked_at(b, a, compose(T, wrong)) < right - 1.0


def test_the_farther_off_the_more_is_looked_through(room):
    (one, other), T = room
    a, b = panorama_of(one), panorama_of(other)
    shares = [looked(a, b, compose(T, moved(x))).share for x in (0.0, 0.4, 0.8)]
    assert shares == sorted(shares)
    assert shares[0] < 0.03


def test_both_scans_say_the_same_whichever_is_first(room):
    (one, other), T = room
    a, b = panorama_of(one), panorama_of(other)
    assert looked_at(b, a, T) == pytest.approx(looked_at(a, b, inverse(T)), abs=1e-9)


def test_paint_speaks_against_a_pose_and_light_hardly(room):
    (one, other), T = room
    chance = torch.rand(len(other.points), 3, generator=torch.Generator().manual_seed(0))
    right = looked_at(panorama_of(other), panorama_of(one), T)
    painted = panorama_of(replace(other, colors=chance))
    dimmer = panorama_of(replace(other, colors=other.colors * 0.85))
    assert looked_at(painted, panorama_of(one), T) < right - 1.0
    assert abs(looked_at(dimmer, panorama_of(one), T) - right) < 0.5


def test_units_do_not_matter(room):
    (one, other), T = room
    far = T.clone()
    far[:3, 3] *= 1000.0

    def in_millimeters(cloud):
        return replace(cloud, points=cloud.points * 1000.0, viewpoint=cloud.viewpoint * 1000.0)

    large = looked_at(panorama_of(in_millimeters(other)), panorama_of(in_millimeters(one)), far)
    assert large == pytest.approx(looked_at(panorama_of(other), panorama_of(one), T), abs=0.05)


def test_only_dense_scans_around_a_known_scanner_have_one(room):
    (one, _), _ = room
    assert panorama_of(replace(one, viewpoint=None)) is None
    few = slice(0, 1999)
    assert (
        panorama_of(replace(one, points=one.points[few], colors=one.colors[few], offsets=torch.tensor([0, 1999])))
        is None
    )


def test_threads_change_no_bit(room):
    (one, _), _ = room
    before = torch.get_num_threads()
    made = []
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            made.append(panorama_of(one))
    finally:
        torch.set_num_threads(before)
    for left, right in zip(*made, strict=True):
        assert torch.equal(left, right) if isinstance(left, torch.Tensor) else left == right


def test_a_site_asks_once_for_poses_that_are_nearly_one_and_doubts_stations_at_one_place(room):
    scans, T = room
    panoramas = [panorama_of(scan) for scan in scans]
    site = SiteSight(panoramas.__getitem__, 2)
    before = site.odds(1, 0, T)
    assert site.odds(1, 0, compose(T, moved(1e-6))) == pytest.approx(before, abs=1e-3)
    site.stations = learned_stations([1.5] * 20)
    assert site.odds(1, 0, T) < before - 1.0
    assert site.odds(1, 0, compose(moved(100.0), T)) == 0.0  # they hardly see the same
    assert site.has(1)
    assert not site.has(2)  # the world


def test_a_panorama_comes_back_from_its_file_and_a_damaged_one_does_not(tmp_path, room):
    (one, _), _ = room
    panorama = panorama_of(one)
    file = panorama_file(tmp_path / "scan.pt")
    assert read_panorama(file) is None
    write_panorama(file, panorama)
    for left, right in zip(read_panorama(file).panorama, panorama, strict=True):
        assert torch.equal(left, right) if isinstance(left, torch.Tensor) else left == right
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    assert read_panorama(file) is None
    write_panorama(file, None)
    assert read_panorama(file).panorama is None
    assert read_panorama(file.rename(tmp_path / "other.panorama")) is None  # another scan's
