"""What ``torchreg bench site`` counts, by hand; sites from files; methods on made-up answers; resumed runs."""

import csv
import json
import math

import pytest
import torch
from refusals import refuses

import torchreg as tr
from torchreg.benchmark.core.study import run_study
from torchreg.benchmark.site import registry
from torchreg.benchmark.site.document import single_sites, tables
from torchreg.benchmark.site.judge import judged_site, placed_errors, verdicts, wrong_scans
from torchreg.benchmark.site.method import SiteAnswer, SiteMethod, SiteTask, along_tree, numbered
from torchreg.benchmark.site.registry import SITE_METHODS, chosen_site_methods
from torchreg.benchmark.site.sources import read_sites
from torchreg.benchmark.site.study import SiteBenchOptions, site_study
from torchreg.benchmark.site.true_site import Readings, known_pairs
from torchreg.errors import CloudFileError
from torchreg.geometry.se3 import rigid


def turned(degrees, axis=2):
    """The rotation (3, 3) about an axis."""
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    R = torch.eye(3, dtype=torch.float64)
    i, j = [k for k in range(3) if k != axis]
    R[i, i], R[i, j], R[j, i], R[j, j] = cosine, -sine, sine, cosine
    return R


def poses(count):
    """(N, 4, 4) along a bent line, each turned otherwise."""
    places = [(2.0 * k, 0.5 * k**2, 0.1 * k) for k in range(count)]
    return torch.stack([rigid(turned(40.0 * k, k % 3), torch.tensor(place).double()) for k, place in enumerate(places)])


def answer(T, group=None, tried=0):
    return SiteAnswer(
        T_world_scan=T, group=torch.zeros(len(T), dtype=torch.int64) if group is None else group, pairs_tried=tried
    )


def readings(T):
    scans = tuple(tr.Clouds(points=torch.rand(5, 3, generator=torch.Generator().manual_seed(k))) for k in range(len(T)))
    return Readings(scans, known_pairs(T), T)


MOVED = rigid(turned(123.0, 1), torch.tensor([5.0, -3.0, 9.0]).double())


def test_the_frame_of_an_answer_is_free():
    truth = readings(poses(5))
    right, mistaken = verdicts(answer(MOVED @ poses(5)), truth, 0.05)
    assert (right, mistaken) == (10, [])
    meters, degrees = placed_errors(MOVED @ poses(5), poses(5), 0.05)
    assert meters.max() < 1e-12
    assert degrees.max() < 1e-10


@pytest.mark.parametrize(("off", "counts"), [(0.29, True), (0.31, False)])
def test_bounds_are_six_voxels_and_five_degrees(off, counts):
    T = poses(3)
    T[2, :3, 3] += torch.tensor([0.0, off, 0.0]).double()
    assert verdicts(answer(T), readings(poses(3)), 0.05)[0] == (3 if counts else 1)
    T = poses(3)
    T[2, :3, :3] = T[2, :3, :3] @ turned(off * 5 / 0.3)
    assert verdicts(answer(T), readings(poses(3)), 1.0)[0] == (3 if counts else 1)


def test_what_is_in_another_frame_or_in_none_is_neither_right_nor_wrong():
    group = torch.tensor([0, 0, 0, 1, 1, -1])
    T = poses(6)
    T[3:5] = MOVED @ T[3:5]
    T[5] = math.nan
    right, mistaken = verdicts(answer(T, group), readings(poses(6)), 0.05)
    assert (right, mistaken) == (4, [])


def test_the_fewest_scans_are_wrong():
    assert wrong_scans([]) == set()
    assert wrong_scans([(0, 3), (1, 3), (3, 4)]) == {3}
    assert len(wrong_scans([(a, b) for a in (0, 1, 2) for b in (3, 4)])) == 2


def test_a_row_by_hand():
    T = MOVED @ poses(4)
    T[1, :3, 3] += MOVED[:3, :3] @ torch.tensor([0.0, 0.0, 9.0]).double()  # wrong
    T[2, :3, 3] += MOVED[:3, :3] @ torch.tensor([0.004, 0.0, 0.0]).double()
    group = torch.tensor([0, 0, 0, -1])
    made = SiteMethod(name="m", title="M", statement="", run=lambda task: answer(T, group, tried=3))
    truth = readings(poses(4))
    row = judged_site(made, SiteTask(scans=truth.scans, voxel=0.05), truth)
    assert row["share"] == pytest.approx(1 / 6)
    assert (row["wrong"], row["unplaced"], row["groups"], row["tried"], row["error"]) == (1, 1, [3], 0.5, "")
    assert 1.0 < row["median_mm"] <= row["largest_mm"] < 3.0  # half of 4 mm on either scan
    assert row["largest_deg"] < 0.3
    unknown = judged_site(made, SiteTask(scans=truth.scans, voxel=0.05), truth._replace(T_world_scan=None))
    assert unknown["median_mm"] is None
    assert unknown["share"] == row["share"]


def test_a_method_that_fails_has_placed_nothing():
    def fail(task):
        raise RuntimeError("out of luck")

    truth = readings(poses(3))
    row = judged_site(
        SiteMethod(name="m", title="M", statement="", run=fail), SiteTask(scans=truth.scans, voxel=1.0), truth
    )
    assert (row["share"], row["wrong"], row["unplaced"], row["groups"]) == (0, 0, 3, [])
    assert row["error"] == "RuntimeError: out of luck"


def test_a_tree_takes_the_surest_links_first():
    T = poses(5)
    pair = {(a, b): torch.linalg.inv(T[b]) @ T[a] for a in range(5) for b in range(5)}
    links = [(0, 1, pair[0, 1]), (3, 2, pair[3, 2]), (2, 1, pair[2, 1]), (0, 3, MOVED)]
    placed = along_tree(5, links)
    assert placed.group.tolist() == [0, 0, 0, 0, -1]
    right, mistaken = verdicts(placed, readings(T), 0.05)
    assert (right, mistaken) == (6, [])
    wrong_first = along_tree(5, links[::-1])
    assert verdicts(wrong_first, readings(T), 0.05)[0] < 6
    assert numbered([7, 3, 3, 3, 7, 1]).tolist() == [1, 0, 0, 0, 1, -1]


@pytest.fixture
def folder(tmp_path):
    """Two sites of made-up scans as files, and a list of pairs."""
    tmp_path = tmp_path / "data"
    tmp_path.mkdir()
    for name, count in (("a", 3), ("b", 2)):
        (tmp_path / name).mkdir()
        entries = []
        for k, T in enumerate(poses(count)):
            points = torch.rand(50, 3, generator=torch.Generator().manual_seed(k))
            tr.write_cloud(tmp_path / name / f"{k}.ply", tr.Clouds(points=points))
            entries.append({"file": f"{k}.ply", "T_world_scan": T.tolist()})
        (tmp_path / name / "site.json").write_text(json.dumps({"voxel_m": 0.05, "scans": entries}))
    pair = {"scene": "s", "voxel_m": 0.05, "overlap": 0.5, "T": MOVED.tolist()}
    listed = [
        {**pair, "name": "0", "source": "a/0.ply", "target": "a/1.ply"},
        {**pair, "name": "1", "source": "a/2.ply", "target": "a/1.ply"},
        {**pair, "name": "2", "source": "b/0.ply", "target": "b/1.ply", "scene": "two clouds alone"},
    ]
    (tmp_path / "list.json").write_text(json.dumps({"pairs": listed}))
    return tmp_path


def test_sites_from_files(folder):
    one, other = read_sites(folder)
    assert (one.name, one.scans, other.name, other.voxel) == ("a", 3, "b", 0.05)
    assert torch.equal(one.read().T_world_scan, poses(3))
    assert len(one.read().pairs) == 3
    (alone,) = read_sites(folder / "b")
    assert alone.name == "b"
    (scene,) = read_sites(folder / "list.json")
    assert (scene.name, scene.scans) == ("s", 3)
    read = scene.read()
    assert read.T_world_scan is None
    assert [(pair.source, pair.target) for pair in read.pairs] == [(0, 1), (2, 1)]
    assert torch.equal(read.pairs[0].T_target_source, MOVED)


def test_what_is_no_site_is_refused(folder):
    with pytest.raises(CloudFileError, match=r"expected site\.json, folders with one, or pairs\.json"):
        read_sites(folder / "nowhere")
    (folder / "a" / "site.json").write_text('{"scans": []}')
    with pytest.raises(CloudFileError, match="voxel_m"):
        read_sites(folder)
    (folder / "a" / "site.json").write_text('{"voxel_m": 1, "scans": []}')
    with pytest.raises(CloudFileError, match="two scans or more, got 0"):
        read_sites(folder)


def install(monkeypatch, *methods):
    monkeypatch.setattr(registry, "SITE_METHODS", {method.name: method for method in methods})


def knowing(name, seen):
    """A method that knows the poses of the made-up scans."""

    def run(task):
        seen.append((name, len(task.scans)))
        return answer(MOVED @ poses(len(task.scans)))

    return SiteMethod(name=name, title=f"the {name}", statement=f"Made up: {name}.", run=run)


def test_the_whole_run_is_written_and_resumed(folder, tmp_path, monkeypatch):
    seen = []
    install(monkeypatch, knowing("one", seen), knowing("two", seen))
    options = SiteBenchOptions(seeds=0, data=(folder / "a",))
    run_study(site_study(options), tmp_path / "out")
    assert seen == [("one", 3), ("two", 3)]
    more = SiteBenchOptions(seeds=0, data=(folder,))
    rows = run_study(site_study(more), tmp_path / "out")
    assert seen[2:] == [("one", 2), ("two", 2)]
    assert [row["share"] for row in rows] == [1.0] * 4
    text = (tmp_path / "out" / "site.md").read_text()
    assert "## Real sites: 2 with 5 scans" in text
    assert "| the one | 1.000 | 0 | 0 | 0.0 / 0.0 | 0.00 / 0.00 | 0.00 |" in text
    assert "Made up: two." in text
    line = next(csv.DictReader((tmp_path / "out" / "site.csv").read_text().splitlines()))
    assert (line["site"], line["method"], float(line["share"])) == ("a", "one", 1.0)
    (family,) = tables(rows, chosen_site_methods(None))
    assert (family.heading, len(family.rows)) == ("Real sites: 2 with 5 scans", 2)
    assert len(single_sites(rows, chosen_site_methods(None)).rows) == 4
    with pytest.raises(ValueError, match="seed"):
        run_study(site_study(SiteBenchOptions(seeds=0, data=(folder,), seed=1)), tmp_path / "out")


def test_sites_and_methods_are_chosen_by_name(folder):
    study = site_study(SiteBenchOptions(seeds=2, scans=(5, 9), data=(folder,), methods=("tree",)))
    assert [cell.key for cell in study.cells] == [
        *(f"building-{seed}-of-{scans}/tree" for scans in (5, 9) for seed in (0, 1)),
        "a/tree",
        "b/tree",
    ]
    chosen = site_study(SiteBenchOptions(data=(folder,), sites=("b",)))
    assert [cell.key for cell in chosen.cells] == [f"b/{name}" for name in SITE_METHODS]
    quick = site_study(SiteBenchOptions(data=(folder,), quick=True, methods=("site",)))
    assert [cell.key for cell in quick.cells] == ["building-0-of-5/site", "b/site"]


@pytest.mark.parametrize(
    ("options", "name", "part"),
    [
        ({"methods": ("best",)}, "methods", "names out of open3d"),
        ({"methods": ()}, "methods", "at least one"),
        ({"sites": ("x",)}, "sites", "names out of building-0"),
        ({"seeds": 0}, "sites", "at least one"),
        ({"scans": (4,)}, "scans", "from 5 to 500, got 4"),
    ],
)
def test_bad_options(options, name, part):
    with refuses(name, part):
        site_study(SiteBenchOptions(**options))


def three_sectors():
    """Three parts of one scan, each two thirds of the circle, in frames of their own."""
    whole = tr.datasets.mall(0, angular_step=1.5).source
    around = torch.atan2(whole.points[:, 1], whole.points[:, 0])
    T = poses(3)
    scans = []
    for k in range(3):
        inside = torch.remainder(around - 2 * math.pi * k / 3, 2 * math.pi) < 4 * math.pi / 3
        inverse = torch.linalg.inv(T[k])
        points = whole.points[inside].double() @ inverse[:3, :3].T + inverse[:3, 3]
        scans.append(
            tr.Clouds(points=points.float(), colors=whole.colors[inside], viewpoint=inverse[None, :3, 3].float())
        )
    return Readings(tuple(scans), known_pairs(T), T)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(SITE_METHODS))
def test_every_method_puts_the_parts_of_a_scan_together(name):
    truth = three_sectors()
    row = judged_site(SITE_METHODS[name], SiteTask(scans=truth.scans, voxel=0.15), truth)
    assert row["error"] == ""
    assert (row["share"], row["wrong"], row["unplaced"], row["tried"]) == (1, 0, 0, 1)
    assert row["largest_mm"] < 100
