"""Registration on keypoints: which points are matched changes, and nothing else."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import torch
from determinism import same_bits
from problems import plane_cloud, room_pair
from refusals import refuses

import torchreg as tr
from torchreg.batch.described_file import described_name, read_described, write_described
from torchreg.keypoints import KEYPOINTS, KeypointRows
from torchreg.keypoints.keypoints import rows_where
from torchreg.registration import describe
from torchreg.registration.looks import second_look
from torchreg.settings import Settings

SPACING = 0.1
REAL = Path(__file__).resolve().parents[3] / "shared" / "data" / "real"
every_rule = pytest.mark.parametrize("name", KEYPOINTS)


@dataclass(frozen=True, kw_only=True)
class Every(tr.Keypoints):
    """Every so manieth point of the batch."""

    name = "every"
    step: int = 1

    @classmethod
    def for_spacing(cls, spacing):
        return cls()

    def select(self, cloud, near):
        assert near is None
        return rows_where(cloud, torch.arange(len(cloud.points)) % self.step == 0)


def pair_of(count=3000, seed=0):
    return room_pair(count, seed=seed)


def options_with(keypoints, **changes):
    return replace(tr.options_for(SPACING), keypoints=keypoints, **changes)


def error(result, truth):
    return float((result.T_target_source - truth).abs().max())


@every_rule
@pytest.mark.parametrize("effort", ["plain", "balanced"])
def test_pairs_are_registered_on_keypoints_alone(name, effort):
    pair, rule = pair_of(), KEYPOINTS[name].for_spacing(SPACING)
    result = tr.register(pair.source, pair.target, options_with(rule, effort=effort))
    if effort != "plain":
        assert bool(result.success[0])
        assert error(result, pair.T_target_source) < 0.1
    assert len(result.correspondences.source) > 0
    for cloud, rows in ((result.source, result.correspondences.source), (result.target, result.correspondences.target)):
        support = rule.support
        near = None if support is None else tr.neighbors(cloud, support.radius, support.max_neighbors)
        assert set(rows.tolist()) <= set(rule.select(cloud, near).rows.tolist())
    assert f"keypoints ({name}) alone are matched" in "\n".join(result.notes[0])


def test_a_rule_that_selects_all_points_changes_no_bit():
    pair = pair_of(700)
    plain = tr.register(pair.source, pair.target, options_with(None))
    every = tr.register(pair.source, pair.target, options_with(Every()))
    assert same_bits(plain, every, ignore=("options", "notes", "seconds"))
    assert every.notes[0][:-1] == plain.notes[0]


@every_rule
def test_a_pair_does_not_depend_on_its_batch_nor_on_lengths_beside_it(name):
    pairs = [pair_of(600, seed) for seed in (1, 2)]
    options = [
        options_with(KEYPOINTS[name].for_spacing(2 * SPACING), effort="fast").scaled(factor) for factor in (1.0, 1.3)
    ]
    sides = [tr.Clouds.pack([getattr(pair, side) for pair in pairs]) for side in ("source", "target")]
    both = tr.register(*sides, options)
    for b, (pair, option) in enumerate(zip(pairs, options, strict=True)):
        alone = tr.register(pair.source, pair.target, option)
        assert same_bits(both[b], alone, ignore=("seconds",))


@every_rule
def test_tiles_select_what_the_whole_cloud_does(name, monkeypatch):
    monkeypatch.setattr(describe, "_LEAST_TILE", 250)
    cloud = pair_of(4000).source
    color = tr.Contrast(radius=3 * SPACING)
    rule = KEYPOINTS[name].for_spacing(SPACING)
    options = options_with(rule, descriptors=(color,), weights=(1.0,), refine="none")
    whole, parts = (describe.describe_clouds(cloud, options, max_bytes=most) for most in (1 << 28, 1))
    assert 0 < int(whole.keypoints.sum()) < len(cloud.points)
    assert torch.equal(whole.keypoints, parts.keypoints)


def test_descriptors_are_those_of_the_whole_cloud():
    cloud = pair_of(900).source
    every, some = (
        describe.describe_clouds(cloud, options_with(rule)) for rule in (None, tr.FarthestKeypoints(count=50))
    )
    assert every.keypoints is None
    assert int(some.keypoints.sum()) == 50
    assert same_bits(every.features, some.features)


def test_the_second_look_matches_keypoints_alone():
    pair, step = pair_of(2000), 3
    options = options_with(Every(step=step))
    sides = [describe.describe_clouds(cloud, options) for cloud in (pair.source, pair.target)]
    proposed = second_look(*sides, options, 0)
    assert {each.coarser for each in proposed} == {1.0, 2.0}
    for each in proposed:
        assert len(each.matches.source) > 0
        if each.coarser == 1.0:
            assert bool((each.matches.source % step == 0).all())
            assert bool((each.matches.target % step == 0).all())
    all_points = second_look(*sides, replace(options, keypoints=None), 0)
    coarse = [[len(one.matches.source) for one in way if one.coarser == 2.0] for way in (proposed, all_points)]
    assert max(coarse[0]) < min(coarse[1])


@pytest.mark.parametrize("effort", ["plain", "balanced"])
def test_clouds_without_keypoints_fail_as_pairs_and_say_why(effort):
    good, flat = pair_of(900), plane_cloud(800, 4.0)
    rule = tr.IssKeypoints.for_spacing(SPACING)
    source = tr.Clouds.pack([tr.Clouds(points=flat.points), tr.Clouds(points=good.source.points)])
    target = tr.Clouds.pack([tr.Clouds(points=flat.points), tr.Clouds(points=good.target.points)])
    options = replace(tr.options_for(SPACING, colored=False), keypoints=rule, effort=effort)
    result = tr.register(source, target, options)
    assert not bool(result.success[0])
    assert result.failure[0].kind == "too few matches"
    assert "0 keypoints (iss) in the source, 0 in the target" in result.reason[0]
    assert "keypoints_source" in result.failure[0].figures
    assert result[0].explain()
    alone = tr.register(tr.Clouds(points=good.source.points), tr.Clouds(points=good.target.points), options)
    assert same_bits(result[1], alone, ignore=("seconds", "failure"))
    assert result.reason[1] == alone.reason[0]


def test_features_from_elsewhere_are_matched_at_keypoints_and_matches_as_they_are():
    pair, step = pair_of(800), 2
    options = options_with(Every(step=step), effort="plain")
    f, g = (torch.rand(len(cloud.points), 8) for cloud in (pair.source, pair.target))
    every = tr.register_features(pair.source, pair.target, f, g, replace(options, keypoints=None))
    some = tr.register_features(pair.source, pair.target, f, g, options)
    assert 0 < len(some.correspondences.source) < len(every.correspondences.source)
    rows = torch.arange(200)
    by_matches = [
        tr.register_matches(pair.source, pair.target, torch.stack([rows, rows], dim=1), each)
        for each in (options, replace(options, keypoints=None))
    ]
    assert same_bits(*by_matches, ignore=("seconds",))


def test_a_module_is_matched_at_keypoints():
    pair = pair_of(800)
    options = options_with(tr.UniformKeypoints(voxel_size=0.4), effort="plain")
    some, every = (
        tr.register(pair.source, pair.target, each, describe=tr.nn.FPFH(binning="hard"))
        for each in (options, replace(options, keypoints=None))
    )
    assert 0 < len(some.correspondences.source) < len(every.correspondences.source)


def test_described_clouds_keep_their_keypoints_on_disk(tmp_path):
    cloud = pair_of(600).source
    options = options_with(tr.FarthestKeypoints(count=40))
    described = describe.describe_clouds(cloud, options)
    write_described(tmp_path / "a.pt", described)
    again = read_described(tmp_path / "a.pt", described.descriptions[0])
    assert torch.equal(again.keypoints, described.keypoints)
    rules = (None, tr.FarthestKeypoints(count=40), tr.FarthestKeypoints(count=41), tr.UniformKeypoints(voxel_size=0.2))
    names = {described_name("0", describe.description_of(options_with(rule), colored=True), "cpu") for rule in rules}
    assert len(names) == len(rules)


def test_lengths_scale_with_the_options():
    options = options_with(tr.IssKeypoints(radius=0.4, non_max_radius=0.2)).scaled(2)
    assert options.keypoints == tr.IssKeypoints(radius=0.8, non_max_radius=0.4)
    assert options_with(tr.UniformKeypoints(voxel_size=0.4)).scaled(0.5).keypoints.voxel_size == 0.2
    assert options_with(tr.FarthestKeypoints(count=7)).scaled(3).keypoints.count == 7


def test_a_result_with_keypoints_loads_without_trust(tmp_path):
    pair = pair_of(400)
    result = tr.register(pair.source, pair.target, options_with(tr.FarthestKeypoints(count=100), effort="plain"))
    torch.save(result, tmp_path / "result.pt")
    again = torch.load(tmp_path / "result.pt", weights_only=True)
    assert again.options[0].keypoints == tr.FarthestKeypoints(count=100)


def test_what_a_rule_selects_is_checked():
    @dataclass(frozen=True, kw_only=True)
    class Wrong(Every):
        rows: tuple[int, ...] = (9999999,)

        def select(self, cloud, near):
            return KeypointRows(torch.tensor(self.rows), torch.tensor([0, len(self.rows)]))

    pair = pair_of(400)
    with refuses("Wrong.select: rows", "of the clouds"):
        tr.register(pair.source, pair.target, options_with(Wrong()))
    with pytest.raises((TypeError, ValueError), match=r"^keypoints: expected Keypoints or None, got"):
        tr.RegistrationOptions(keypoints="iss")
    with refuses("options.keypoints", "matched softly"):
        tr.nn.Register(replace(tr.PAPER, keypoints=Every()))


def test_rules_for_some_clouds_alone_are_refused():
    clouds, rule = tr.Clouds.pack([pair_of(200).source] * 2), tr.UniformKeypoints(voxel_size=0.4)
    assert describe.select(clouds, None, [None, None]) is None
    for rules in ([rule, None], [None, rule, rule.scaled(2)]):
        with refuses("keypoints", "a rule for every cloud or for none"):
            describe.select(clouds, None, rules)


@every_rule
def test_the_command_line_takes_a_rule_by_its_name(name):
    options = Settings(keypoints=name).over(tr.options_for(0.05))
    assert options.keypoints == KEYPOINTS[name].for_spacing(0.05)
    with refuses("keypoints"):
        Settings(keypoints="none such")


@pytest.mark.real
@pytest.mark.slow
@pytest.mark.skipif(not REAL.exists(), reason="no real pairs beside the checkout")
@every_rule
def test_real_pairs_are_found_on_keypoints(name):
    pairs = json.loads((REAL / "pairs.json").read_text())["pairs"]
    found = 0
    for pair in (pairs[0], pairs[3], pairs[21], pairs[34]):
        source, target = (tr.read_cloud(REAL / pair[side]) for side in ("source", "target"))
        (derived,) = tr.derive_options(source, target)
        rule = KEYPOINTS[name].for_spacing(derived.normal_radius / 2)
        result = tr.register(source, target, replace(derived, keypoints=rule))
        truth = torch.tensor(pair["T"], dtype=torch.float64)[None]
        found += bool(result.success[0]) and bool(tr.metrics.recalled_by_error(truth, result.T_target_source)[0])
    assert found >= 3
