"""What a pair lacks is said before anything is computed."""

from dataclasses import replace

import pytest
import torch
from determinism import same_bits
from problems import random_rotation, room_pair

import torchreg as tr
from torchreg.registration.inspect import facts_of, notes_on, refuse, set_aside

GOOD = tr.Clouds(points=torch.rand(10, 3, generator=torch.Generator().manual_seed(0)))


def line(rows=20, seed=0, dtype=torch.float32):
    along = random_rotation(torch.Generator().manual_seed(seed))[0]
    return (torch.linspace(-3, 7, rows, dtype=torch.float64)[:, None] * along + 2).to(dtype)


def spoiled(value):
    points = torch.rand(10, 3, generator=torch.Generator().manual_seed(1))
    points[4, 2] = value
    return points


@pytest.mark.parametrize(
    ("points", "reason"),
    [
        (torch.zeros(0, 3), "too few points: the {} has 0, at least 4 are needed"),
        (torch.zeros(1, 3), "too few points: the {} has 1"),
        (torch.rand(3, 3), "too few points: the {} has 3"),
        (spoiled(float("nan")), "points that are not finite: 1 of 10 in the {}"),
        (spoiled(float("inf")), "points that are not finite: 1 of 10 in the {}"),
        (torch.full((9, 3), 2.5), "a degenerate cloud: all 9 points of the {} coincide"),
        (line(), "a degenerate cloud: the points of the {} lie on one line"),
        (line(dtype=torch.float64), "a degenerate cloud: the points of the {} lie on one line"),
        (torch.arange(12.0)[:, None].expand(12, 3).contiguous(), "a degenerate cloud: the points of the {} lie on one"),
    ],
)
def test_a_pair_is_refused_for_either_of_its_clouds(points, reason):
    bad = tr.Clouds(points=points)
    good = tr.Clouds(points=GOOD.points.to(points.dtype))
    assert refuse(bad, good)[0].text.startswith(reason.format("source"))
    assert refuse(good, bad)[0].text.startswith(reason.format("target"))


@pytest.mark.parametrize("seed", range(10))
def test_any_line_is_seen(seed):
    for dtype in (torch.float32, torch.float64):
        (failure,) = refuse(tr.Clouds(points=line(seed=seed, dtype=dtype)), GOOD)
        assert failure.kind == "degenerate"
        assert failure.text.endswith("lie on one line")


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_a_plane_and_a_volume_are_taken(scale):
    flat = scale * torch.rand(10, 3, generator=torch.Generator().manual_seed(2))
    good = tr.Clouds(points=scale * GOOD.points)
    assert refuse(tr.Clouds(points=flat), good) == [None]
    flat[:, 1] = 0
    assert refuse(tr.Clouds(points=flat), good) == [None]


def test_every_pair_has_its_own_reason():
    clouds = [GOOD.points, torch.zeros(0, 3), line(), GOOD.points]
    source = tr.Clouds.pack([tr.Clouds(points=points) for points in clouds])
    target = tr.Clouds.pack([GOOD] * 4)
    assert [failure is not None for failure in refuse(source, target)] == [False, True, True, False]


def test_refused_pairs_are_emptied_and_the_others_left_alone():
    made = [room_pair(50, seed=seed).source for seed in range(3)]
    packed = tr.Clouds.pack(made)
    kept = set_aside(packed, [None, "why not", None])
    assert kept.lengths == [packed.lengths[0], 0, packed.lengths[2]]
    assert same_bits(kept.select([0, 2]), packed.select([0, 2]))
    assert set_aside(packed, [None, None, None]) is packed


def test_notes_name_what_is_missing():
    options = (tr.PAPER, tr.RegistrationOptions(voxel_size=0.1234))
    pair = room_pair(50)
    full, bare = tr.Clouds.pack([pair.source] * 2), tr.Clouds(points=torch.zeros(2, 3), offsets=torch.tensor([0, 1, 2]))
    assert notes_on(full, full, options) == ((), ("downsampled to voxels of 0.123 m",))
    first, _ = notes_on(full, bare, options)
    assert first[0].startswith("no colors in target: geometry alone")
    assert first[1].startswith("no viewpoint for the target")
    first, _ = notes_on(bare, bare, options)
    assert first[0].startswith("no colors in source and target")
    assert [note.split(":")[0] for note in first[1:]] == ["no viewpoint for the source", "no viewpoint for the target"]


def test_notes_name_the_sides_whose_viewpoint_is_assumed():
    known = room_pair(50).source
    guessed, bare = replace(known, viewpoint_assumed=torch.tensor([True])), replace(known, viewpoint=None)
    words = "the scanner's position is only assumed for the "
    for source, target, starts in (
        (guessed, known, [f"{words}source"]),
        (known, guessed, [f"{words}target"]),
        (guessed, guessed, [f"{words}source and the target"]),
        (guessed, bare, ["no viewpoint for the target", f"{words}source"]),
    ):
        (notes,) = notes_on(source, target, (tr.PAPER,))
        assert [note.split(":")[0] for note in notes] == starts


def test_the_facts_of_a_cloud_tell_a_known_viewpoint_from_a_guess_and_from_none():
    known = room_pair(50).source
    guessed, bare = replace(known, viewpoint_assumed=torch.tensor([True])), replace(known, viewpoint=None)
    facts = facts_of(tr.Clouds.pack([known, guessed, bare]))
    assert [(one.faced, one.assumed) for one in facts] == [(True, False), (False, True), (False, False)]


def test_a_viewpoint_of_nan_counts_as_unknown():
    pair = room_pair(50)
    unknown = tr.Clouds(points=pair.source.points, colors=pair.source.colors)
    source = tr.Clouds.pack([pair.source, unknown])
    notes = notes_on(source, source, (tr.PAPER, tr.PAPER))
    assert notes[0] == ()
    assert len(notes[1]) == 2


def test_what_becomes_of_given_normals_is_noted():
    pair = room_pair(300)
    source = tr.estimate_normals(pair.source, tr.neighbors(pair.source, 0.8, 20))
    known = tr.register(source, pair.target).notes[0]
    assert "normals of the source are estimated anew, turned to its scanner" in known
    blind = replace(source, viewpoint=None)
    given = tr.register(blind, pair.target).notes[0]
    assert "normals of the source are estimated anew, on the sides of the given ones, where these agree" in given
    assert not any("normals of the target" in note for note in (*known, *given))


@pytest.mark.parametrize("effort", ["plain", "balanced"])
def test_a_descriptor_that_describes_nothing_is_named_with_its_scale(effort):
    pair = room_pair(900)
    packed = [tr.Clouds.pack([cloud, cloud]) for cloud in (pair.source, pair.target)]
    options = replace(tr.options_for(0.2, colored=False), effort=effort)
    blind = replace(options, descriptors=(tr.Fpfh(radius=1e-4),))
    result = tr.register(*packed, [blind, options])
    spacing = [facts_of(cloud)[0].spacing for cloud in (pair.source, pair.target)]
    for note, name, about in zip(result.notes[0], ("source", "target"), spacing, strict=True):
        text, _, number = note.rpartition(" the spacing of the points ")
        assert text == f"fpfh describes no point of the {name}: its radius is 0.0001 m,"
        assert float(number.removesuffix(" m")) == pytest.approx(about, rel=0.5)
        assert note in result.reason[0]
    assert result.reason[0].startswith("too few matches: 0")
    assert result.notes[1] == ()
    assert "describes no point" not in result.reason[1]


def test_a_descriptor_that_describes_nothing_beside_others_is_noted_alone():
    pair = room_pair(900)
    both = (tr.Fpfh(radius=1e-4), tr.Contrast(radius=1.0))
    options = replace(tr.options_for(0.2), descriptors=both, weights=(1.0, 1.0), effort="plain")
    result = tr.register(pair.source, pair.target, options)
    assert [note.split(":")[0] for note in result.notes[0]] == [
        "fpfh describes no point of the source",
        "fpfh describes no point of the target",
    ]
    assert "describes no point" not in result.reason[0]
