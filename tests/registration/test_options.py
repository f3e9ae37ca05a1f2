"""Options are checked when made; the defaults are the paper's."""

import dataclasses
from dataclasses import replace

import pytest
from problems import room_pair
from refusals import refuses

import torchreg as tr


def test_the_defaults_are_those_of_section_4_1():
    options = tr.RegistrationOptions()
    assert (options.normal_radius, options.normal_max_neighbors) == (2.0, 30)
    assert (options.feature_radius, options.feature_max_neighbors) == (5.0, 100)
    assert (options.color, options.color_radius, options.color_bins) == (("pcfh",), 2.0, 11)
    assert (options.color_channels, options.equalization) == (("hue",), "cloud")
    assert options.ransac == tr.RansacOptions(
        hypotheses=600_000, confidence=0.999, edge_similarity=0.9, inlier_threshold=0.2, sample_size=3
    )
    assert options == tr.PAPER


@pytest.mark.parametrize("options", [tr.RansacOptions(), tr.RegistrationOptions()])
def test_options_are_frozen_and_named(options):
    with pytest.raises(dataclasses.FrozenInstanceError):
        options.confidence = 0.5
    with pytest.raises(TypeError):
        type(options)(1)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("hypotheses", 0),
        ("hypotheses", 1.5),
        ("hypotheses", True),
        ("confidence", 0.0),
        ("confidence", 1.01),
        ("confidence", float("nan")),
        ("edge_similarity", -0.1),
        ("edge_similarity", 1.1),
        ("inlier_threshold", 0.0),
        ("inlier_threshold", float("inf")),
        ("inlier_threshold", float("nan")),
        ("sample_size", 2),
        ("local_optimization", -1),
    ],
)
def test_ransac_options_out_of_range_are_refused(name, value):
    with refuses(name, repr(value)):
        tr.RansacOptions(**{name: value})


@pytest.mark.parametrize(
    ("fields", "name"),
    [
        ({"voxel_size": 0.0}, "voxel_size"),
        ({"voxel_size": -1.0}, "voxel_size"),
        ({"normal_radius": 0.0}, "normal_radius"),
        ({"normal_max_neighbors": 2}, "normal_max_neighbors"),
        ({"feature_radius": float("nan")}, "feature_radius"),
        ({"feature_max_neighbors": 0}, "feature_max_neighbors"),
        ({"color_radius": -2.0}, "color_radius"),
        ({"color_bins": 0}, "color_bins"),
        ({"color": ("rgb",)}, "color"),
        ({"color_weights": (0.0,)}, "color_weights"),
        ({"color_weights": (1.0, 1.0)}, "color_weights"),
        ({"color": (), "color_weights": (1.0,)}, "color_weights"),
        ({"descriptors": ()}, "descriptors"),
        ({"weights": (1.0,)}, "weights"),
        ({"solver": "guess"}, "solver"),
        ({"effort": "some"}, "effort"),
        ({"color_channels": ("red",)}, "color_channels"),
        ({"color_channels": ()}, "color_channels"),
        ({"equalization": "histogram"}, "equalization"),
        ({"ratio": 0.0}, "ratio"),
        ({"ratio": 1.5}, "ratio"),
    ],
)
def test_registration_options_out_of_range_are_refused(fields, name):
    with refuses(name):
        tr.RegistrationOptions(**fields)


@pytest.mark.parametrize(("name", "value"), [("confidence", "high"), ("edge_similarity", None), ("ratio", "0.8")])
def test_options_of_another_type_are_refused_by_name(name, value):
    kind = tr.RegistrationOptions if name == "ratio" else tr.RansacOptions
    with refuses(name, repr(value)):
        kind(**{name: value})


def test_geometry_alone_is_an_option():
    assert tr.RegistrationOptions(color=(), color_weights=()).color == ()


def test_former_names_are_read_and_taken():
    options = tr.RegistrationOptions(
        feature_radius=3.0, color=("contrast", "pcfh"), color_weights=(0.7, 0.4), color_radius=1.5, color_bins=5
    )
    assert options.descriptors == (
        tr.Fpfh(radius=3.0),
        tr.Contrast(radius=1.5),
        tr.Pcfh(radius=1.5, bins=5),
    )
    assert options.weights == (1.0, 0.7, 0.4)
    assert (options.feature_radius, options.color_radius, options.color_bins) == (3.0, 1.5, 5)
    assert (options.color, options.color_weights) == (("contrast", "pcfh"), (0.7, 0.4))
    assert replace(options, color_radius=2.0, color=("pcfh",)).descriptors == (
        tr.Fpfh(radius=3.0),
        tr.Pcfh(radius=2.0, bins=5),
    )
    assert replace(options, feature_max_neighbors=40).feature_max_neighbors == 40


def test_ransac_beside_another_solver_keeps_its_options_and_shares_its_threshold():
    ransac = tr.RansacOptions(inlier_threshold=0.5, local_optimization=3, hypotheses=7)
    assert tr.RegistrationOptions(ransac=ransac).solver is ransac
    sets = tr.CompatibilityOptions(nodes=300, inlier_threshold=0.5)
    by_sets = tr.RegistrationOptions(solver=sets, ransac=ransac)
    assert by_sets.solver == sets
    assert replace(by_sets, root=0.5).ransac == ransac
    assert by_sets.ransac == ransac
    assert tr.RegistrationOptions(solver="compatibility", ransac=ransac).inlier_threshold == 0.5
    assert replace(by_sets, solver="ransac").solver == ransac
    assert (
        replace(replace(tr.RegistrationOptions(ransac=ransac), solver="compatibility"), solver="ransac").solver
        == ransac
    )
    wider = replace(by_sets, solver=replace(by_sets.solver, inlier_threshold=0.7))
    assert (wider.inlier_threshold, wider.ransac) == (0.7, replace(ransac, inlier_threshold=0.7))
    finer = replace(wider, ransac=replace(wider.ransac, inlier_threshold=0.1))
    assert (finer.inlier_threshold, finer.ransac.inlier_threshold, finer.solver.nodes) == (0.1, 0.1, 300)
    doubled = finer.scaled(2)
    assert (doubled.solver, doubled.ransac) == (finer.solver.scaled(2), finer.ransac.scaled(2))
    assert replace(doubled, root=0.5) == replace(finer, root=0.5).scaled(2)
    derived = tr.options_for(0.1)
    assert replace(derived, solver="ransac").inlier_threshold == derived.ransac.inlier_threshold
    for solver in (tr.RansacOptions(hypotheses=5), tr.CompatibilityOptions(inlier_threshold=0.6)):
        with refuses("ransac", "agrees with the solver"):
            tr.RegistrationOptions(solver=solver, ransac=ransac)
        with refuses("ransac", "agrees with the solver"):
            replace(by_sets, solver=solver, ransac=replace(ransac, hypotheses=8))


def test_thorough_runs_ransac_by_its_own_options():
    pair = room_pair(400)
    options = replace(
        tr.options_for(0.3, effort="thorough"), ransac=tr.RansacOptions(inlier_threshold=0.4, hypotheses=9)
    )
    proposals = tr.register(pair.source, pair.target, options).stages[0].proposals
    assert {proposal.drawn for proposal in proposals if proposal.origin.endswith("ransac")} == {9}


def test_color_that_is_put_back_has_the_scale_of_the_geometry():
    bare = tr.options_for(0.1).without_color()
    (_, color) = replace(bare, color=("pcfh",), color_weights=(0.5,)).descriptors
    assert color == tr.Pcfh(radius=bare.feature_radius)
    assert bare.color_radius == bare.feature_radius


def test_former_names_leave_records_of_one_class_alone():
    two = tr.RegistrationOptions(
        descriptors=(tr.Pcfh(radius=1), tr.Fpfh(radius=1), tr.Pcfh(radius=2, bins=5)), weights=(1, 0.5, 0.25)
    )
    assert replace(two, color=two.color) == two
    assert replace(two, color_weights=(2.0, 3.0)).weights == (2.0, 0.5, 3.0)
    with refuses("color_radius", "not 2"):
        replace(two, color_radius=1.5)
    assert replace(two, feature_radius=3.0).descriptors[1] == tr.Fpfh(radius=3.0)


@pytest.mark.parametrize(
    ("former", "named"),
    [
        ({"color": (), "color_radius": -1}, "color_radius"),
        ({"color": (), "color_bins": "x"}, "color_bins"),
        ({"color": ("contrast",), "equalization": "foo"}, "equalization"),
        ({"color_weights": 1.0}, "color_weights"),
    ],
)
def test_former_names_refuse_what_no_record_reads_too(former, named):
    with refuses(named):
        tr.RegistrationOptions(**former)


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"descriptors": tr.Fpfh(radius=1)}, "descriptors"),
        ({"descriptors": 5}, "descriptors"),
        ({"weights": 1.0}, "weights"),
        ({"ransac": "x"}, "ransac"),
        ({"solver": 3}, "solver"),
    ],
)
def test_other_types_are_refused_by_name(given, named):
    with pytest.raises(TypeError, match=rf"^{named}: expected .*, got "):
        tr.RegistrationOptions(**given)


@pytest.mark.parametrize("factor", [0, -1, "2", None, float("nan")])
def test_a_factor_that_scales_nothing_is_refused(factor):
    with refuses("factor"):
        tr.PAPER.scaled(factor)


def test_options_are_keys():
    assert len({tr.PAPER, tr.RegistrationOptions(), tr.LEARNED, tr.options_for(0.1)}) == 3


@pytest.mark.parametrize("effort", ["plain", "fast", "balanced", "thorough"])
def test_effort_changes_no_length_of_options_that_are_given(effort):
    pair = room_pair(400)
    options = tr.options_for(0.2)
    one = tr.register(pair.source, pair.target, options, effort=effort)
    other = tr.register(pair.source, pair.target, replace(options, effort=effort))
    assert one.options == other.options == (replace(options, effort=effort),)
    assert (one.T_target_source == other.T_target_source).all()
