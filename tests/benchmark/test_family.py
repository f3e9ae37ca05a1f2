"""``torchreg bench family``: which descriptors are fused with what, what counts as found, and runs on made-up rooms."""

import csv
import json
from dataclasses import dataclass, replace

import pytest
from real_folders import project
from refusals import refuses

import torchreg as tr
from torchreg.benchmark.core.real_pairs import read_real_pairs
from torchreg.benchmark.core.study import run_study
from torchreg.benchmark.family.document import document, scores, tables
from torchreg.benchmark.family.fusions import DEFAULT, FPFH, WIDE, chosen_fusions, fusions
from torchreg.benchmark.family.measure import EFFORTS
from torchreg.benchmark.family.pairs import chosen_pairs, thin_pair
from torchreg.benchmark.family.study import FamilyOptions, family_study
from torchreg.benchmark.family.summary import FIGURES, difference, found, found_closely, found_plain, score
from torchreg.descriptors import DESCRIPTORS
from torchreg.descriptors.descriptor import Descriptor
from torchreg.registration import options_for


@dataclass(frozen=True, kw_only=True)
class Crowd(Descriptor):
    """How many neighbors a point has."""

    name = "crowd"

    def describe(self, cloud, near):
        count = near.valid.sum(dim=1, keepdim=True).to(cloud.points)
        return tr.Features(count, cloud.offsets, ((self.name, 1),), valid=count[:, 0] > 0)


@dataclass(frozen=True, kw_only=True)
class Broken(Crowd):
    name = "broken"

    def describe(self, cloud, near):
        raise RuntimeError("out of order")


@pytest.fixture
def data(tmp_path):
    """Rooms of two scenes; the last one's list says that it has no colors."""
    folder = tmp_path / "data"
    folder.mkdir()
    project(folder)
    content = json.loads((folder / "pairs.json").read_text())
    content["pairs"][-1]["colour"] = False
    (folder / "pairs.json").write_text(json.dumps(content))
    return folder


def test_every_descriptor_of_the_library_is_there_alone_and_wide():
    names = [fusion.name for fusion in fusions()]
    assert len(set(names)) == len(names)
    assert names[: len(DESCRIPTORS)] == list(DESCRIPTORS)
    assert {f"{name}/wide" for name in DESCRIPTORS} <= set(names)
    assert {f"{name}+fpfh" for name in DESCRIPTORS if name != "fpfh"} <= set(names)
    assert {"fpfh+color", "fpfh/root", "fpfh+color/root", "learned+fpfh+color"} <= set(names)
    assert not {"contrast+color", "contrast+fpfh+color", "pcfh+fpfh+color"} & set(names)  # the default's own color


def test_a_new_descriptor_joins_by_its_name_alone(monkeypatch):
    monkeypatch.setitem(DESCRIPTORS, "crowd", Crowd)
    of = {fusion.name: fusion.options(0.1, colored=True) for fusion in fusions() if fusion.kind is Crowd}
    names = {name: [record.name for record in options.descriptors] for name, options in of.items()}
    assert names == {
        "crowd": ["crowd"],
        "crowd/wide": ["crowd"],
        "crowd+fpfh": ["fpfh", "crowd"],
        "crowd+color": ["crowd", "contrast", "pcfh"],
        "crowd+fpfh+color": ["fpfh", "crowd", "contrast", "pcfh"],
    }


@pytest.mark.parametrize("colored", [True, False])
def test_the_bases_are_the_default_and_its_fpfh(colored):
    usual = replace(options_for(0.07, colored=colored), refine="none")
    assert DEFAULT.options(0.07, colored=colored) == usual
    assert FPFH.options(0.07, colored=colored) == replace(options_for(0.07, colored=False), refine="none")


def test_a_fusion_holds_what_its_name_says():
    of = {fusion.name: fusion.options(0.1, colored=True) for fusion in fusions()}
    names = {name: [record.name for record in options.descriptors] for name, options in of.items()}
    assert names["learned+fpfh+color"] == ["fpfh", "contrast", "pcfh", "learned"]
    assert names["learned+fpfh"] == ["fpfh", "learned"]
    assert of["learned+fpfh+color"].weights == (1.0, 0.8, 0.5, 1.0)
    (wide,) = of["fpfh/wide"].descriptors
    assert (wide.radius, wide.max_neighbors) == (pytest.approx(0.1 * WIDE), 256)
    assert of["fpfh+color/root"] == replace(of["fpfh+color"], root=1.0)


def test_chosen_fusions_have_the_bases_with_them():
    assert [each.name for each in chosen_fusions(["pcfh", "fpfh/root"])] == ["fpfh", "pcfh", "fpfh+color", "fpfh/root"]
    assert chosen_fusions(None) == fusions()
    with refuses("fusions", "fpfh+color"):
        chosen_fusions(["best"])
    with refuses("fusions", "at least one"):
        chosen_fusions([])


def test_pairs_are_chosen_evenly_and_thinned(data):
    lists = (("real", data), ("hard", data / "pairs.json"))
    assert [pair.key for pair in chosen_pairs(lists, every=2)] == [
        *("real/pair_0", "real/pair_2", "hard/pair_0", "hard/pair_2")
    ]
    assert [pair.key for pair in chosen_pairs(lists, quick=True)] == ["real/pair_0", "hard/pair_0"]
    assert [pair.key for pair in chosen_pairs(lists[:1], scenes=["yard"])] == ["real/pair_2"]
    with refuses("scenes", "hall, yard"):
        chosen_pairs(lists, scenes=["attic"])
    with refuses("pairs", "--real"):
        chosen_pairs((("real", None), ("hard", None)))
    first, _, last = read_real_pairs(data)
    whole, few = thin_pair(first), thin_pair(first, 200)
    assert (whole.edge, whole.colored) == (first.voxel, True)
    assert 100 < max(len(few.source.points), len(few.target.points)) <= 200
    assert few.edge > whole.edge
    assert not thin_pair(last).colored


def test_a_row_has_the_figures_of_register(data, tmp_path):
    study = family_study(FamilyOptions(real=data, fusions=["contrast", "contrast+fpfh"]))
    rows = {(row["pair"], row["fusion"]): row for row in run_study(study, tmp_path / "out")}
    assert ("pair_2", "contrast") not in rows  # which has no colors
    assert len(rows) == 3 * 4 - 1
    for (name, fusion), row in rows.items():
        pair = next(each for each in read_real_pairs(data) if each.name == name)
        thin = thin_pair(pair)
        options = next(each for each in fusions() if each.name == fusion).options(thin.edge, colored=thin.colored)
        results = {effort: tr.register(thin.source, thin.target, options, effort=effort) for effort in EFFORTS}
        for prefix, effort in (("", "balanced"), ("plain_", "plain")):
            result = results[effort]
            error = float(tr.metrics.rre(pair.T_target_source, result.T_target_source[0]))
            assert row[f"{prefix}rre_deg"] == pytest.approx(error, abs=1e-9)
        assert row["probability"] == float(results["balanced"].probability[0])
        assert row["error"] == ""
        assert 0 < row["describe_s"] < row["seconds"]
        assert row["bytes"] == 4 * row["dimensions"] * sum(row["points"])
    gray = [rows["pair_2", name] for name in ("fpfh", "fpfh+color", "contrast+fpfh")]
    assert all({**row, "fusion": "", "key": ""} == {**gray[0], "fusion": "", "key": ""} for row in gray)
    assert rows["pair_0", "fpfh"]["dimensions"] == 33
    assert rows["pair_0", "fpfh+color"]["dimensions"] == 33 + 10 + 33
    lines = list(csv.reader((tmp_path / "out" / "family.csv").read_text().splitlines()))
    assert len(lines) == 1 + len(rows)
    again = []
    run_study(study, tmp_path / "out", again.append)
    assert again == []


def test_matches_alone_decide_where_that_is_asked(data, tmp_path):
    study = family_study(FamilyOptions(real=data, fusions=["pcfh"], quick=True, effort="plain"))
    rows = run_study(study, tmp_path / "out")
    assert all((row["rre_deg"], row["rte_m"]) == (row["plain_rre_deg"], row["plain_rte_m"]) for row in rows)
    assert {row["probability"] for row in rows} == {None}
    assert score(rows).brier is None
    assert "## Verdicts" not in (tmp_path / "out" / "family.md").read_text()
    with refuses("effort", "plain"):
        family_study(FamilyOptions(real=data, effort="much"))


def test_a_descriptor_that_fails_has_found_nothing(data, tmp_path, monkeypatch):
    monkeypatch.setitem(DESCRIPTORS, "broken", Broken)
    study = family_study(FamilyOptions(hard=data, fusions=["broken"], quick=True))
    rows = run_study(study, tmp_path / "out")
    (row,) = (row for row in rows if row["fusion"] == "broken")
    assert "out of order" in row["error"]
    assert not found(row)
    assert score([row]).errors == 1
    assert study.shown(rows)[-1] == "broken ended with an error on 1 pairs, first: RuntimeError: out of order"


def row(pair, fusion="fpfh", scene="s", **more):
    usual = {"list": "real", "colored": True, "voxel_m": 0.05, "rre_deg": 1.0, "rte_m": 0.1, "plain_rre_deg": 1.0}
    usual |= {"plain_rte_m": 0.1, "inlier_ratio": 0.2, "success": True, "probability": 1.0, "dimensions": 33}
    usual |= {"bytes": 2_000_000, "describe_s": 0.1, "match_s": 0.2, "seconds": 1.0, "error": ""}
    return {"pair": pair, "fusion": fusion, "scene": scene, **usual, **more}


def test_found_is_within_fifteen_degrees_and_six_voxels():
    assert found(row("1"))
    assert not found(row("1", rre_deg=15.0))
    assert found(row("1", rre_deg=5.0))
    assert not found_closely(row("1", rre_deg=5.0))
    assert found_closely(row("1", rre_deg=4.9))
    assert not found_closely(row("1", rte_m=0.301))
    assert not found(row("1", rte_m=0.301))
    assert found(row("1", rte_m=0.299))
    assert not found(row("1", rre_deg=None))
    assert found(row("1", plain_rre_deg=19.0))
    assert not found_plain(row("1", plain_rre_deg=19.0))


def test_figures_are_those_by_hand():
    rows = [
        row("1"),
        row("2", rre_deg=90.0, probability=0.75, inlier_ratio=0.05),  # wrong, called a success
        row("3", success=False, probability=0.5, seconds=3.0, rre_deg=9.0),  # right, refused
        row("4", rre_deg=90.0, success=False, probability=0.25, plain_rre_deg=None, dimensions=None, bytes=None),
    ]
    cell = score(rows)
    assert (cell.pairs, cell.recall, cell.plain_recall, cell.match_recall) == (4, 0.5, 0.75, 0.75)
    assert (cell.wrong, cell.refused, cell.errors, cell.dimensions, cell.megabytes) == (1, 1, 0, 33, 2.0)
    assert cell.brier == pytest.approx((0.75**2 + 0.5**2 + 0.25**2) / 4)
    assert cell.close_recall == 0.25
    assert (cell.probability_right, cell.probability_wrong) == (0.75, 0.5)
    assert cell.seconds == 1.0
    assert score(rows[:1]).probability_wrong is None


def test_differences_are_pair_by_pair_and_over_scenes():
    base = [row("1"), row("2"), row("3", scene="t"), row("4", scene="u")]
    others = [row("1", rre_deg=90.0), row("2", rre_deg=90.0), row("3", scene="t")]
    less = difference(others, base, FIGURES["recall"])
    assert less.value == pytest.approx(-2 / 3)
    assert (less.low, less.high) == (-1.0, 0.0)  # only one scene, or only the other
    assert difference(others, [], FIGURES["recall"]) is None
    of_scores = {(each["group"], each["fusion"]): each for each in scores(base, [FPFH])}
    assert of_scores["real/s", "fpfh"]["pairs"] == 2
    assert of_scores["all pairs", "fpfh"]["recall less fpfh"].value == 0


def test_no_line_of_a_table_is_wider_than_a_terminal():
    scenes = [f"a_scene_of_some_name_{number}" for number in range(10)]
    rows = [
        row(scene, fusion.name, scene, list=of_list, inlier_ratio=1.0, dimensions=1344, colored=colored)
        for fusion in fusions()
        for of_list, colored in (("real", True), ("hard", False))
        for scene in scenes
        if fusion.fits(colored=colored)
    ]
    rows = [each if each["fusion"] == "fpfh" else {**each, "rre_deg": 90.0, "inlier_ratio": 0.0} for each in rows]
    made = tables(rows, fusions())
    headings = [table.heading for table in made]
    assert headings[:3] == [
        *("Pairs with colors: 10 of 10 scenes", "Pairs with colors: less fpfh", "Pairs with colors: less fpfh+color"),
    ]
    assert headings[3:5] == ["Pairs without colors: 10 of 10 scenes", "Pairs without colors: less fpfh"]
    gray = {line[0] for line in made[3].rows}
    assert "fpfh+color" not in gray
    assert "contrast" not in gray
    assert {"fpfh", "fpfh/wide", "fpfh/root"} <= gray
    by_scene = [heading for heading in headings if heading.startswith("Found, real pairs: ")]
    assert by_scene == [
        "Found, real pairs: " + ", ".join(f"{letter} {scene} (1)" for letter, scene in zip("abcde", part, strict=True))
        for part in (scenes[:5], scenes[5:])
    ]
    lines = [line for line in document(rows, fusions(), "machine").splitlines() if line.startswith("|")]
    assert max(map(len, lines)) <= 80


def test_a_count_below_one_is_refused(data):
    with refuses("every"):
        family_study(FamilyOptions(real=data, every=0))
    with refuses("scenes", "at least one"):
        family_study(FamilyOptions(real=data, scenes=()))


def test_figures_do_not_depend_on_what_else_is_measured(data, tmp_path):
    alone = run_study(family_study(FamilyOptions(real=data, fusions=["pcfh"], quick=True)), tmp_path / "a")
    beside = run_study(family_study(FamilyOptions(real=data, fusions=["contrast", "pcfh"], quick=True)), tmp_path / "b")
    times = ("describe_s", "match_s", "seconds")
    strip = [[{k: v for k, v in each.items() if k not in times} for each in rows] for rows in (alone, beside)]
    assert [each for each in strip[1] if each["fusion"] != "contrast"] == strip[0]
