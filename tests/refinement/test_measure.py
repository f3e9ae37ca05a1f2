"""What the surfaces of a pair ask for: the true pose, as well as its covariance says, and the same in any batch."""

from dataclasses import replace

import pytest
import torch
from determinism import same_bits
from problems import room_site, seeded

from torchreg.geometry.se3 import compose, inverse, rigid
from torchreg.geometry.small_motions import rotation_of, rotation_vector
from torchreg.refinement.measure import measure
from torchreg.refinement.pairing import Pairing
from torchreg.refinement.surfels import Surfels, surfels_of


@pytest.fixture(scope="module")
def room():
    return room_site(4, points=6000)


@pytest.fixture(scope="module")
def surfels(room):
    return [surfels_of(scan, 3000) for scan in room.scans]


def true_pose(room, target, source):
    return compose(inverse(room.T_world_scan[target]), room.T_world_scan[source])


def off_by(T, meters, seed):
    numbers = meters * torch.randn(6, generator=seeded(seed), dtype=torch.float64)
    return compose(rigid(rotation_of(numbers[:3] / 3), numbers[3:]), T)


def asked(surfels, pairs, start):
    sources = Surfels.pack([surfels[source] for _, source in pairs])
    targets = Surfels.pack([surfels[target] for target, _ in pairs])
    pairing = Pairing(range(len(pairs)), range(len(pairs)))
    return measure(sources, targets, pairing, torch.stack(start), [0.1] * len(pairs))


PAIRS = [(0, 1), (0, 2), (1, 3), (2, 3)]


def test_repeated_it_comes_to_the_true_pose_as_well_as_it_says(room, surfels):
    poses = [off_by(true_pose(room, *pair), 0.02, seed) for seed, pair in enumerate(PAIRS)]
    for _ in range(6):
        measured = asked(surfels, PAIRS, poses)
        poses = [one.T_target_source for one in measured]
    for pair, one in zip(PAIRS, measured, strict=True):
        D = compose(one.T_target_source, inverse(true_pose(room, *pair)))
        off = torch.cat([rotation_vector(D[:3, :3]), D[:3, :3] @ one.center + D[:3, 3] - one.center])
        assert off[3:].norm() < 0.003
        assert off @ torch.linalg.solve(one.covariance, off) < 40  # six squared deviations, 22 in one of a thousand
        assert one.residuals[0] < 0.003


def test_a_pair_has_the_same_bits_alone_and_in_any_batch(room, surfels):
    start = [off_by(true_pose(room, *pair), 0.01, seed) for seed, pair in enumerate(PAIRS)]
    together = asked(surfels, PAIRS, start)
    for number, pair in enumerate(PAIRS):
        (alone,) = asked(surfels, [pair], start[number : number + 1])
        assert same_bits(alone.T_target_source, together[number].T_target_source)
        assert same_bits(alone.covariance, together[number].covariance)


def test_two_sides_of_a_wall_are_no_partners_where_scanners_are_known(room, surfels):
    def seen_from_behind(one):
        return replace(one, cloud=replace(one.cloud, normals=-one.cloud.normals))

    def unknown(one):
        return replace(one, cloud=replace(one.cloud, viewpoint=None))

    start = [true_pose(room, 0, 1)]
    turned = [surfels[0], seen_from_behind(surfels[1])]
    assert asked(turned, [(0, 1)], start) == [None]
    right, behind = (asked([*map(unknown, each)], [(0, 1)], start)[0] for each in (surfels, turned))
    assert same_bits(right.T_target_source, behind.T_target_source)


def test_scans_that_share_nothing_say_nothing(room, surfels):
    away = true_pose(room, 0, 1)
    away[:3, 3] += 100.0
    assert asked(surfels, [(0, 1)], [away]) == [None]


def test_normals_face_the_scanner(surfels):
    cloud = surfels[0].cloud
    assert ((cloud.normals * (cloud.viewpoint - cloud.points)).sum(dim=1) >= 0).all()
