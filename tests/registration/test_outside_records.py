"""A descriptor and a solver from outside the package: written as records, they take part like those within."""

from dataclasses import dataclass, replace
from itertools import combinations
from typing import ClassVar

import pytest
import torch
from determinism import same_bits
from problems import room_pair
from refusals import refuses

import torchreg as tr
from torchreg.solvers import Hypotheses, MatchedPoints
from torchreg.types.lengths import length


@dataclass(frozen=True, kw_only=True)
class Shape(tr.Descriptor):
    """Principal spreads of the neighborhood and its mean color: what anyone could write in ten lines."""

    name: ClassVar[str] = "shape"
    needs_colors: ClassVar[bool] = True

    def describe(self, cloud, near):
        mask = near.valid[..., None]
        points = torch.where(mask, cloud.points[near.index] - cloud.points[:, None], 0) / self.radius  # (P, K, 3)
        count = mask.sum(dim=1).clamp(min=1)
        spread = torch.linalg.eigvalsh((points.mT @ points / count[..., None]).double()).to(points)
        color = torch.where(mask, cloud.colors[near.index], 0).sum(dim=1) / count
        values = torch.cat([spread, color], dim=1)
        return tr.Features(values, cloud.offsets, ((self.name, 6),), valid=mask[:, :, 0].sum(dim=1) > 3)


@dataclass(frozen=True, kw_only=True)
class AllTriples(tr.Solver):
    """Kabsch on all triples of a few matches, evenly chosen."""

    name: ClassVar[str] = "all triples"
    few: int = 24

    def propose(self, points: MatchedPoints) -> Hypotheses:
        hypotheses = Hypotheses(points, self.inlier_threshold)
        count = points.source.shape[1]
        chosen = torch.arange(min(self.few, count)) * count // min(self.few, count)
        triples = torch.tensor(list(combinations(chosen.tolist(), 3)))  # (T, 3)
        T = tr.kabsch(points.source[:, triples].permute(1, 2, 0), points.target[:, triples].permute(1, 2, 0))
        hypotheses.drawn = hypotheses.kept = len(triples)
        hypotheses.add(T[:, :3, :3].permute(1, 2, 0), T[:, :3, 3].t())
        return hypotheses


def options_with(spacing, *records, solver=None):
    options = tr.options_for(spacing)
    solver = options.solver if solver is None else solver
    return replace(options, descriptors=(*options.descriptors, *records), weights=None, solver=solver)


@pytest.mark.parametrize("effort", ["plain", "fast", "balanced", "thorough"])
def test_a_descriptor_from_outside_takes_part(effort):
    pair = room_pair(2500)
    spacing = float(tr.spacing(pair.source)[0])
    options = replace(options_with(spacing, Shape(radius=4 * spacing)), effort=effort)
    result = tr.register(pair.source, pair.target, options)
    assert result.success.tolist() == [True], result.reason
    assert float(tr.metrics.rre(pair.T_target_source, result.T_target_source)) < 3
    assert any("shape" in proposal.origin for proposal in result.stages[0].proposals)
    without = tr.register(pair.source, pair.target, replace(tr.options_for(spacing), effort=effort))
    assert not same_bits(result.correspondences, without.correspondences)


def test_clouds_of_several_scales_are_described_as_each_alone():
    pairs = [room_pair(700, scale=scale, seed=5) for scale in (1.0, 3.0)]
    spacings = [float(tr.spacing(pair.source)[0]) for pair in pairs]
    options = [options_with(spacing, Shape(radius=4 * spacing)) for spacing in spacings]
    source, target = (tr.Clouds.pack(side) for side in zip(*(pair[:2] for pair in pairs), strict=True))
    together = tr.register(source, target, options)
    for b, pair in enumerate(pairs):
        alone = tr.register(pair.source, pair.target, options[b])
        assert same_bits(together.T_target_source[b : b + 1], alone.T_target_source)
        assert same_bits(together.probability[b : b + 1], alone.probability)


def test_what_needs_colors_is_left_out_where_there_are_none():
    pair = room_pair(2500)
    bare = [replace(cloud, colors=None) for cloud in pair[:2]]
    spacing = float(tr.spacing(pair.source)[0])
    options = options_with(spacing, Shape(radius=4 * spacing))
    result = tr.register(*bare, options)
    assert all(proposal.origin.startswith("fpfh, compatibility") for proposal in result.stages[0].proposals)
    with refuses("options.descriptors", "needs no colors"):
        tr.register(*bare, replace(options, descriptors=(Shape(radius=1.0),), weights=None))


@pytest.mark.parametrize("effort", ["plain", "balanced", "thorough"])
def test_a_solver_from_outside_registers(effort):
    pair = room_pair(2500)
    spacing = float(tr.spacing(pair.source)[0])
    solver = AllTriples(inlier_threshold=1.5 * spacing, few=40)
    options = replace(tr.options_for(spacing), solver=solver, effort=effort)
    result = tr.register(pair.source, pair.target, options)
    assert result.success.tolist() == [True], result.reason
    assert float(tr.metrics.rre(pair.T_target_source, result.T_target_source)) < 3
    assert any(proposal.origin.endswith("all triples") for proposal in result.stages[0].proposals)
    assert same_bits(tr.register(pair.source, pair.target, options), result, ignore=("seconds",))
    by_name = tr.register(pair.source, pair.target, tr.options_for(spacing), solver=solver, effort=effort)
    assert same_bits(by_name, result, ignore=("seconds",))


def test_a_record_without_its_function_or_a_wrong_answer_is_refused_by_name():
    @dataclass(frozen=True, kw_only=True)
    class Short(Shape):
        name: ClassVar[str] = "short"

        def describe(self, cloud, near):
            return super().describe(cloud, near).values

    pair = room_pair(300)
    with refuses("Short.describe", "Features"):
        tr.register(pair.source, pair.target, options_with(0.1, Short(radius=0.5)))
    with pytest.raises(TypeError, match="descriptors: expected a sequence of Descriptor"):
        tr.RegistrationOptions(descriptors=("fpfh",))
    with pytest.raises(TypeError, match="solver: expected Solver"):
        tr.RegistrationOptions(solver=3)
    with pytest.raises(TypeError, match="no option 'collor'"):
        tr.RegistrationOptions(collor=())


@dataclass(frozen=True, kw_only=True)
class Ring(tr.Descriptor):
    """Neighbors beyond an inner radius, which must be the smaller one."""

    name: ClassVar[str] = "ring"
    inner: float = length()

    def __post_init__(self):
        super().__post_init__()
        if not self.inner < self.radius:
            raise ValueError(f"inner: expected less than radius, got {self.inner}")

    def describe(self, cloud, near):
        beyond = near.valid & (near.sq_distance > self.inner**2)
        count = beyond.sum(dim=1, keepdim=True).to(cloud.points)
        return tr.Features(count, cloud.offsets, ((self.name, 1),), valid=count[:, 0] > 0)


def test_lengths_that_must_differ_may_differ_in_a_batch():
    pairs = [room_pair(500, scale=scale, seed=5) for scale in (1.0, 3.0)]
    options = [options_with(0.2 * scale, Ring(radius=scale, inner=0.5 * scale)) for scale in (1.0, 3.0)]
    source, target = (tr.Clouds.pack(side) for side in zip(*(pair[:2] for pair in pairs), strict=True))
    together = tr.register(source, target, options)
    alone = [tr.register(pair.source, pair.target, option) for pair, option in zip(pairs, options, strict=True)]
    assert same_bits(together.T_target_source, torch.cat([one.T_target_source for one in alone]))


@pytest.mark.parametrize("spoiled", ["nan", "garbage in a row that is not valid"])
def test_features_that_would_spoil_others_are_refused(spoiled):
    @dataclass(frozen=True, kw_only=True)
    class Spoiled(Shape):
        name: ClassVar[str] = "spoiled"

        def describe(self, cloud, near):
            features = super().describe(cloud, near)
            values, valid = features.values.clone(), features.valid.clone()
            if spoiled == "nan":
                values[0, 0] = float("nan")
            else:
                valid[0] = False
            return replace(features, values=values, valid=valid)

    pair = room_pair(300)
    with refuses("Spoiled.describe", "rows of finite numbers"):
        tr.register(pair.source, pair.target, options_with(0.2, Spoiled(radius=0.8)))


@pytest.mark.parametrize("answer", [None, float("nan")])
def test_a_solver_that_answers_nonsense_is_refused(answer):
    @dataclass(frozen=True, kw_only=True)
    class Nonsense(AllTriples):
        name: ClassVar[str] = "nonsense"

        def propose(self, points):
            hypotheses = super().propose(points)
            hypotheses.add(torch.full((3, 3, 1), float("nan")), torch.zeros(3, 1))
            return None if answer is None else hypotheses

    pair = room_pair(400)
    with refuses("Nonsense.propose"):
        tr.register(pair.source, pair.target, options_with(0.3, solver=Nonsense(inlier_threshold=0.4)))


def test_a_record_that_is_no_key_is_refused():
    @dataclass(frozen=True, kw_only=True)
    class Listed(Shape):
        name: ClassVar[str] = "listed"
        parts: list

    with pytest.raises(TypeError, match="descriptors: expected a frozen record"):
        tr.RegistrationOptions(descriptors=(Listed(radius=1.0, parts=[1]),))
    assert tr.Pcfh(radius=1.0, channels=["hue"]) == tr.Pcfh(radius=1.0)


def test_lengths_scale_together():
    options = tr.options_for(0.1)
    record = Shape(radius=0.3)
    doubled = replace(options, descriptors=(*options.descriptors, record), weights=None, voxel_size=0.2).scaled(2)
    assert doubled.descriptors[-1] == Shape(radius=0.6)
    assert doubled.voxel_size == 0.4
    assert doubled.normal_radius == 2 * options.normal_radius
    assert doubled.inlier_threshold == 2 * options.inlier_threshold
    assert [one.radius for one in doubled.descriptors[:-1]] == [2 * one.radius for one in options.descriptors]
