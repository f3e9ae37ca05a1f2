"""What ways and methods share: the transforms are those of ``register``, and unturned normals keep their lines."""

from dataclasses import replace

import pytest
import torch
from problems import room_pair

import torchreg as tr
from torchreg.benchmark.paper.measure import error_cells, stream, trial
from torchreg.benchmark.paper.methods import METHODS, options_of
from torchreg.benchmark.paper.places import REAL, Place
from torchreg.benchmark.paper.settings import FULL, RUNS, SETTINGS
from torchreg.benchmark.paper.sides import described
from torchreg.benchmark.paper.ways import WAYS, unturned
from torchreg.datasets import ScanPair
from torchreg.geometry.se3 import apply_rotation

CPU = torch.device("cpu")
SIZE = FULL._replace(hypotheses=20_000)


@pytest.fixture(scope="module")
def place():
    pair = room_pair(1500, seed=3)
    scanned = ScanPair(pair.source, pair.target, pair.T_target_source[0], "room")
    return Place(group=REAL, name="room", number=5, scale=0.25, ways=WAYS, scan=lambda: scanned)


@pytest.fixture(scope="module")
def rows(place):
    setting = SETTINGS[0]._replace(points=(1200, 1000))
    return setting, [cell.measure() for cell in error_cells([place], [setting], SIZE, CPU)]


def test_shared_descriptions_and_matches_give_the_transforms_of_register(place, rows):
    setting, measured = rows
    one = trial(place.clouds(), setting, place, SIZE, CPU)
    compared = 0
    for row in measured:
        way = next(way for way in WAYS if way.name == row["way"])
        if way.turned:
            options = options_of(row["method"], scale=place.scale, hypotheses=SIZE.hypotheses, refit=way.refit)
            result = tr.register(one.source, one.target, options, seed=stream(place.number, 2))
            assert result.T_target_source[0].tolist() == row["T_target_source"]
            assert len(result.correspondences.source) == row["matches"]
            compared += 1
    assert compared == 2 * len(METHODS)


def test_every_row_has_the_errors_of_all_runs(rows):
    _, measured = rows
    assert len(measured) == len(WAYS) * len(METHODS)
    assert all(len(row[name]) == RUNS for row in measured for name in ("rre_degrees", "rte_meters", "rmse_meters"))
    assert any(len(set(row["rmse_meters"])) == RUNS for row in measured)  # draws differ


def test_a_row_does_not_depend_on_the_rows_before_it(place, rows):
    """Resumed in the middle, a run measures the same: nothing is carried over but what is shared."""
    setting, measured = rows
    last = error_cells([place], [setting], SIZE, CPU)[-1]
    assert last.measure() == measured[-1]


def test_unturned_normals_keep_their_lines_and_take_signs_by_the_frame(place):
    options = options_of(METHODS[0], scale=place.scale)
    cloud = described(place.clouds()[0], place.scale).cloud
    loose = unturned(cloud, options)
    cosine = (loose.normals * cloud.normals).sum(dim=1)
    assert torch.equal(cosine.abs().round(decimals=4), torch.ones_like(cosine))
    assert 0.05 < float((cosine < 0).float().mean()) < 0.95  # no side of a surface is preferred

    T = SETTINGS[1].pose.matrix()
    moved = tr.transform(cloud, T)
    back = apply_rotation(T[:3, :3].T, unturned(moved, options).normals.double())
    agreeing = (back * loose.normals).sum(dim=1) > 0
    assert 0.05 < float(agreeing.float().mean()) < 0.95  # signs do not turn with the cloud


def test_unturned_needs_normals(place):
    cloud = replace(place.clouds()[0], normals=None)
    with pytest.raises(ValueError, match="cloud: expected normals"):
        unturned(cloud, options_of(METHODS[0]))
