"""Units are told by extents and spacings together; a patch, a thinned cloud and a cloud of two densities pass."""

import pytest
import torch
from problems import room_pair

import torchreg as tr
from torchreg.registration.inspect import facts_of, notes_on, refuse
from torchreg.registration.units import Lengths, extents_note, feet_note, rough_spacing, units_failure

ROOM = Lengths(6.0, 0.05)
FACTORS = {1000.0: "millimeters", 304.8: "feet", 100.0: "centimeters", 39.37: "inches", 25.4: "inches"}


def times(lengths, extent, spacing):
    return Lengths(lengths.extent * extent, lengths.spacing * spacing)


@pytest.mark.parametrize("factor", FACTORS)
@pytest.mark.parametrize("off", [(1.0, 1.0), (0.8, 0.9), (1.1, 1.2)])
def test_both_ratios_name_the_unit_and_the_larger_cloud(factor, off):
    large = times(ROOM, factor * off[0], factor * off[1])
    for sides, words in (((large, ROOM), "source is about"), ((ROOM, large), "target is about")):
        failure = units_failure(*sides)
        assert failure.kind == "units"
        assert words in failure.text
        assert FACTORS[factor] in failure.text
        assert failure.figures["factor"] == factor
        assert failure.figures["extent_ratio"] == pytest.approx(factor * off[0])
        assert failure.figures["spacing_ratio"] == pytest.approx(factor * off[1])


@pytest.mark.parametrize("factor", [2.0, 3.2808, 10.0, *FACTORS])
def test_one_ratio_alone_says_nothing(factor):
    for other in (times(ROOM, factor, 1.0), times(ROOM, 1.0, factor), times(ROOM, factor, 1 / factor)):
        for sides in ((ROOM, other), (other, ROOM)):
            assert units_failure(*sides) is None
            assert feet_note(*sides) == ""


def test_a_patch_in_a_map_of_wide_spacing_passes_where_it_spans_enough_of_it():
    patch, wide = Lengths(2.0, 0.002), Lengths(60.0, 0.06)
    assert wide.extent / patch.extent == wide.spacing / patch.spacing == pytest.approx(30)
    assert units_failure(patch, wide) is None
    assert units_failure(Lengths(0.2, 0.002), wide._replace(extent=6.0)) is not None


def test_feet_beside_meters_are_a_remark_and_no_refusal():
    feet = times(ROOM, 3.5, 3.0)
    assert units_failure(ROOM, feet) is None
    assert feet_note(ROOM, feet).startswith("the target is about 3.5 times")
    assert feet_note(feet, ROOM).startswith("the source is about 3.5 times")
    assert feet_note(ROOM, times(ROOM, 3.3, 2.4)) == ""


def test_lengths_that_mean_nothing_are_no_unit():
    assert units_failure(Lengths(0.0, 0.05), ROOM) is None
    assert units_failure(Lengths(6000.0, 0.0), ROOM) is None
    assert feet_note(Lengths(19.7, 0.0), ROOM) == ""


@pytest.mark.parametrize("seed", range(3))
def test_the_rough_spacing_is_near_the_exact_one_and_grows_with_the_cloud(seed):
    cloud = room_pair(4000, seed=seed).source
    assert rough_spacing(cloud) == pytest.approx(float(tr.spacing(cloud)[0]), rel=0.25)
    assert rough_spacing(tr.Clouds(points=4 * cloud.points)) == 4 * rough_spacing(cloud)
    assert rough_spacing(tr.Clouds(points=cloud.points[:4])) == 0.0


def test_a_pair_in_two_units_is_refused_before_it_is_described_and_its_neighbors_are_not():
    pairs = [room_pair(600, seed=seed) for seed in range(2)]
    large = tr.Clouds(points=1000 * pairs[0].source.points)
    source = tr.Clouds.pack([large, tr.Clouds(points=pairs[1].source.points)])
    target = tr.Clouds.pack([tr.Clouds(points=pair.target.points) for pair in pairs])
    first, second = refuse(source, target)
    assert first.kind == "units"
    assert second is None
    result = tr.register(source, target)
    assert result.failure[0] == first
    assert result.stages[0].points == (0, 0)
    assert result.stages[1].points != (0, 0)


def test_the_notes_have_the_remark():
    cloud = tr.Clouds(points=room_pair(600).source.points)
    (notes,) = notes_on(cloud, tr.Clouds(points=3.28 * cloud.points), (tr.PAPER,))
    assert notes[-1].endswith("feet beside meters?")
    assert facts_of(cloud)[0].lengths.spacing > 0


def test_extents_that_differ_a_thousandfold_are_a_remark():
    wide = times(ROOM, 1000.0, 1.0)
    assert units_failure(ROOM, wide) is None
    assert extents_note(ROOM, wide).startswith("the target spans 1e+03 times as much as the source, 6e+03 m beside 6 m")
    assert extents_note(wide, ROOM).startswith("the source spans 1e+03 times")
    assert extents_note(ROOM, times(ROOM, 990.0, 1.0)) == ""
    assert extents_note(ROOM, Lengths(6000.0, 0.0)) == ""


def test_a_point_far_off_is_remarked_on():
    points = room_pair(600).source.points
    cloud, stray = tr.Clouds(points=points), tr.Clouds(points=torch.cat([points, torch.full((1, 3), 1e5)]))
    (notes,) = notes_on(stray, cloud, (tr.PAPER,))
    assert notes[-1].startswith("the source spans ")


@pytest.mark.parametrize("count", [120, 1200])
def test_few_points_that_are_left_are_remarked_on(count):
    pair = room_pair(count)
    result = tr.register(pair.source, pair.target, effort="fast")
    left = dict(zip(("source", "target"), result.stages[0].points, strict=True))
    assert (max(left.values()) < 100) == (count == 120)
    for name, points in left.items():
        said = any(note.startswith(f"only {points} points of the {name} are left") for note in result.notes[0])
        assert said == (points < 100)
