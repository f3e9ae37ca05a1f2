"""Measuring: draws, places, and lists of real pairs."""

import json
import math
from dataclasses import replace

import pytest
import torch
from problems import room_pair
from refusals import refuses

import torchreg as tr
from torchreg.benchmark.paper.measure import error_cells, trial
from torchreg.benchmark.paper.methods import FUSED
from torchreg.benchmark.paper.places import GROUPS, REAL, Place, real_places, simulated_places
from torchreg.benchmark.paper.settings import FULL, QUICK, SETTINGS, settings_of
from torchreg.benchmark.paper.study import chosen_places, paper_study
from torchreg.benchmark.paper.ways import MAIN_WAYS, OURS, WAYS
from torchreg.datasets import ScanPair
from torchreg.errors import CloudFileError

CPU = torch.device("cpu")


def room(number=0, count=1500):
    """A place that takes no time: a room with colors."""
    pair = room_pair(count, seed=number + 1)
    scanned = ScanPair(pair.source, pair.target, pair.T_target_source[0], "room")
    return Place(group=REAL, name=f"room-{number}", number=number, scale=0.25, ways=(OURS,), scan=lambda: scanned)


def test_all_initial_poses_see_the_same_points():
    place = room()
    clouds = place.clouds()
    one, other = (trial(clouds, setting, place, FULL, CPU) for setting in settings_of(1)[:2])
    assert torch.equal(one.source.points, other.source.points)
    back = [tr.transform(t.target, torch.linalg.inv(t.T_target_source)) for t in (one, other)]
    placed = [cloud.points.double() + cloud.origin for cloud in back]
    torch.testing.assert_close(*placed, atol=1e-4, rtol=0)


def test_fewer_points_are_part_of_more_and_the_sides_differ():
    place = room()
    source, _ = place.clouds()
    many, few = (trial((source, source), setting, place, FULL, CPU) for setting in settings_of(3)[2:])
    assert len(many.source.points) == 1000
    assert len(few.source.points) == 500
    kept = {tuple(point) for point in many.source.points.tolist()}
    assert {tuple(point) for point in few.source.points.tolist()} < kept
    target = tr.transform(few.target, torch.linalg.inv(few.T_target_source))
    shared = torch.cdist(few.source.points, target.points + target.origin.float()).amin(dim=1) < 1e-4
    assert float(shared.float().mean()) < 0.6  # of 1,500 points 500 for each: a third by chance


def test_the_initial_pose_is_the_truth_that_is_found():
    """A room that registers well has small errors and true matches: frames, orders and draws fit together."""
    setting = replace_points(SETTINGS[0], 5000)
    cells = error_cells([room(1, count=6000)], [setting], FULL._replace(hypotheses=50_000), CPU)
    assert len(cells) == 3
    found = next(row for row in (cell.measure() for cell in cells) if row["method"] == FUSED)
    assert max(found["rre_degrees"]) < 5
    assert max(found["rmse_meters"]) < 0.1
    assert found["inlier_ratio"] > 0.01  # chance brings one in thousands
    T = torch.tensor(found["T_target_source"], dtype=torch.float64)
    assert float(tr.metrics.rre(setting.pose.matrix(), T)) == pytest.approx(found["rre_degrees"][0])


def test_scans_are_read_once_and_outdoor_settings_stay_out():
    settings = [replace_points(setting, 300) for setting in (*settings_of(2), *settings_of(3), *settings_of(5))]
    read = []
    place = room()
    counted = replace(place, scan=lambda: read.append(1) or place.scan())
    cells = error_cells([counted], settings, FULL._replace(hypotheses=1000), CPU)
    assert len({cell.key for cell in cells}) == len(cells) == 5 * 3
    assert all(cell.measure()["experiment"] in (2, 3) for cell in cells)
    assert len(read) == 1


def test_simulated_places_are_scanned_from_one_place_and_the_first_from_two():
    places = simulated_places(3, 2, angular_step=2.0, beyond=1)
    assert {place.group for place in places} == {group for group in GROUPS if not group.real}
    names = ["mall-3", "road-3", "mall-4", "road-4"]
    assert [place.name for place in places if place.group.paper] == names  # some of each, wherever a run stops
    assert [place.name for place in places][: len(names)] == names
    assert [place.ways for place in places[:4]] == [WAYS, WAYS, MAIN_WAYS, MAIN_WAYS]
    assert {place.ways for place in places[4:]} == {(OURS,)}
    assert len({place.name for place in places}) == len(places)
    for place in (places[0], places[4]):
        source, target = place.clouds()
        apart = (source.viewpoint + source.origin - target.viewpoint).norm()
        assert float(apart) == pytest.approx(place.group.baseline, abs=1e-4)
    assert [place.group.baseline for place in (places[0], places[4])] == [0.1, 1.0]
    assert all(place.group.paper for place in simulated_places(0, 1, angular_step=2.0))
    with refuses("seeds"):
        simulated_places(0, 0, angular_step=2.0)
    with refuses("seed"):
        simulated_places(1.5, 1, angular_step=2.0)


def test_more_places_continue_those_there_are():
    few, more = (simulated_places(0, count, angular_step=2.0, beyond=1) for count in (2, 4))
    shared = [place for place in more if place.number < 2]
    assert [(place.name, place.ways) for place in few] == [(place.name, place.ways) for place in shared]


def entry(**changes):
    T = torch.eye(4).tolist()
    fields = {"name": "a", "scene": "a", "source": "a.ply", "target": "b.ply", "T": T, "voxel_m": 0.05}
    return {**fields, "overlap": 0.7, "colour": True, "kind": "indoor"} | changes


def write_list(folder, *entries):
    (folder / "pairs.json").write_text(json.dumps({"pairs": list(entries)}))


def test_real_places_are_pairs_with_colors_and_much_overlap(tmp_path):
    write_list(
        tmp_path,
        entry(),
        entry(name="b", overlap=0.5),
        entry(name="c", colour=False),
        entry(name="d", kind="OUTDOOR, castle", voxel_m=0.3),
    )
    for name in ("a.ply", "b.ply"):
        tr.write_cloud(tmp_path / name, tr.Clouds(torch.rand(20, 3), colors=torch.rand(20, 3)))
    places = real_places(tmp_path, 0)
    assert [place.name for place in places] == ["a", "d"]
    assert [place.group.outdoor for place in places] == [False, True]
    assert [place.scale for place in places] == pytest.approx([0.25, 1.5])
    assert len(places[0].clouds()[0].points) == 20


def test_a_list_without_such_a_pair_is_refused(tmp_path):
    write_list(tmp_path, entry(overlap=0.2))
    with pytest.raises(CloudFileError, match="expected a pair with colors"):
        real_places(tmp_path, 0)


def test_studies_refuse_what_they_cannot_run():
    with refuses("experiments", "at least one"):
        paper_study(())
    with refuses("experiments", "1 to 5"):
        paper_study((6,))
    outdoor = chosen_places((5,), quick=True, seeds=1, seed=0, real=None)
    assert [place.group.outdoor for place in outdoor] == [True]
    timed = chosen_places((4,), quick=True, seeds=1, seed=0, real=None)
    assert [place.name for place in timed] == ["mall-0"]
    assert QUICK.divisor > 1
    assert math.isclose(FULL.angular_step, 0.4)


def replace_points(setting, count):
    return setting._replace(points=(count, count))
