"""A kind of place from outside the package: one record, and it is scanned as the mall and the road are."""

import numpy as np
import pytest
import torch
from determinism import same_bits
from scans import colors_of, in_target, nearest

import torchreg as tr
from torchreg.datasets import ScanPair
from torchreg.synthetic.scene.environment import Environment, scan_twice
from torchreg.synthetic.scene.light import indoor_light
from torchreg.synthetic.scene.paint import muted, paint, vivid
from torchreg.synthetic.scene.placing import FIXED, ONLY_TARGET, Pieces, scatter
from torchreg.synthetic.scene.quads import Quads, boxes, rectangles, up
from torchreg.synthetic.scene.scanner import LaserScanner

SIZE = np.array([8.0, 6.0, 3.0])


def walls(size, rng):
    x, y, z = size
    color = muted(rng)
    floor = rectangles((0, 0, 0), (x, 0, 0), (0, y, 0), paint(rng, color, 0.8 * color, pattern="tiles"))
    sides = boxes(
        [(0, -y / 2, z / 2), (0, y / 2, z / 2), (-x / 2, 0, z / 2), (x / 2, 0, z / 2)],
        [(x, 0.1, z), (x, 0.1, z), (0.1, y, z), (0.1, y, z)],
        paint(rng, muted(rng, 4)),
    )
    return Quads.join([floor, sides])


def crate(rng):
    return boxes(up(0.4), (0.8, 0.8, 0.8), paint(rng, vivid(rng)))


def crates(size, stations, rng):
    def anywhere(radius, rng):
        return rng.uniform(-size[:2] / 2 + radius, size[:2] / 2 - radius, (100, 2))

    return scatter(
        [Pieces(crate, 0.6, 2, FIXED), Pieces(crate, 0.6, 1, ONLY_TARGET)], anywhere, np.zeros((0, 3)), stations, rng
    )


ROOM = Environment(
    name="room",
    first_stream=1000,
    plan=lambda rng: SIZE * rng.uniform(0.9, 1.1, 3),
    fixtures=(walls,),
    contents=(crates,),
    middle=lambda size: ((-0.5, -0.5, 1.4), (0.5, 0.5, 1.6)),
    longest_baseline=3,
    light=lambda size, weather, rng: indoor_light(
        np.array([[0, 0, size[2]]]), np.array([10.0]), up(size[2]), 1.0, weather, rng
    ),
    probes=lambda size: np.array([[0.0, 0.0, 1.0]]),
    sunlit=0.1,
    scanner=LaserScanner(highest=80.0),
)


def room(seed: int, **options: float) -> ScanPair:
    return scan_twice(
        ROOM, seed, **{"baseline": 2.0, "angular_step": 1.0, "range_noise": 0.004, "relight": 1.0} | options
    )


def test_the_place_is_scanned_and_the_truth_brings_its_scans_together():
    pair = room(0)
    assert pair.name == "room-0"
    assert min(pair.source.lengths + pair.target.lengths) > 10_000
    assert (nearest(in_target(pair), pair.target.points.numpy())[1] < 0.1).mean() > 0.7
    assert pair.T_target_source[:3, 3].norm().item() == pytest.approx(2.0)
    assert same_bits(pair, room(0))
    assert not torch.equal(pair.T_target_source, room(1).T_target_source)


def test_an_option_of_one_stage_leaves_the_others_alone():
    plain, relit, noisy = room(0), room(0, relight=2.0), room(0, range_noise=0.0)
    assert torch.equal(plain.source.points, relit.source.points)
    assert not torch.equal(colors_of(plain.source), colors_of(relit.source))
    assert torch.equal(colors_of(plain.target), colors_of(noisy.target))
    assert torch.equal(plain.T_target_source, noisy.T_target_source)


def test_the_longest_baseline_is_that_of_the_place():
    with pytest.raises(ValueError, match=r"baseline: expected meters in \[0, 3\], got 4"):
        room(0, baseline=4)


def test_simulated_places_are_public_in_both_packages():
    assert tr.synthetic.mall is tr.datasets.mall
    assert tr.synthetic.road is tr.datasets.road
    assert tr.synthetic.match_problem is tr.datasets.match_problem
