"""Options are checked when made; the defaults are the paper's."""

import dataclasses

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
    assert dataclasses.replace(options, color_radius=2.0, color=("pcfh",)).descriptors == (
        tr.Fpfh(radius=3.0),
        tr.Pcfh(radius=2.0, bins=5),
    )
    assert dataclasses.replace(options, feature_max_neighbors=40).feature_max_neighbors == 40


def test_the_former_name_of_ransac_sets_the_threshold_of_any_solver():
    ransac = tr.RansacOptions(inlier_threshold=0.5, local_optimization=3)
    assert tr.RegistrationOptions(ransac=ransac).solver is ransac
    by_sets = tr.RegistrationOptions(solver=tr.CompatibilityOptions(nodes=300), ransac=ransac)
    assert by_sets.solver == tr.CompatibilityOptions(nodes=300, inlier_threshold=0.5, local_optimization=3)
    assert by_sets.ransac == ransac
    assert tr.RegistrationOptions(solver="compatibility", ransac=ransac).inlier_threshold == 0.5
    assert dataclasses.replace(by_sets, solver="ransac").solver == ransac
    assert dataclasses.replace(tr.options_for(0.1), solver="ransac").inlier_threshold == pytest.approx(0.15)
    assert dataclasses.replace(tr.options_for(0.1), solver="ransac").scaled(2).inlier_threshold == pytest.approx(0.3)


def test_options_are_keys():
    assert len({tr.PAPER, tr.RegistrationOptions(), tr.LEARNED, tr.options_for(0.1)}) == 3


@pytest.mark.parametrize("effort", ["plain", "fast", "balanced", "thorough"])
def test_effort_changes_no_length_of_options_that_are_given(effort):
    pair = room_pair(400)
    options = tr.options_for(0.2)
    one = tr.register(pair.source, pair.target, options, effort=effort)
    other = tr.register(pair.source, pair.target, dataclasses.replace(options, effort=effort))
    assert one.options == other.options == (dataclasses.replace(options, effort=effort),)
    assert (one.T_target_source == other.T_target_source).all()
