"""Points averaged in cubes while they come: what is kept does not depend on how they came."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from torchreg.io import Reading, read_cloud_report
from torchreg.io.assemble import RawCloud
from torchreg.io.stream import Thinning, collect, stream_of
from torchreg.io.thin import CloudRows, VoxelGrid


def rows(count, seed=0, size=10.0):
    draw = np.random.default_rng(seed)
    return CloudRows(
        draw.uniform(-size, size, (count, 3)),
        draw.integers(0, 256, (count, 3)).astype(np.uint8),
        draw.normal(size=(count, 3)),
        draw.uniform(0, 1, count),
    )


def thinned(parts, **options):
    grid = VoxelGrid(**options)
    for part in parts:
        grid.add(part)
    return grid, grid.take()


def plain_means(whole, edge, anchor):
    """Cube by cube, in a dictionary."""
    cubes = {}
    for k, number in enumerate(map(tuple, np.floor((whole.points - anchor) / edge).astype(int))):
        cubes.setdefault(number, []).append(k)
    return [np.array([part[cubes[key]].mean(axis=0) for key in sorted(cubes)]) for part in whole[:4]]


@pytest.mark.parametrize("voxel", [0.5, 3.0])
def test_means_are_those_of_a_dictionary_of_cubes(voxel):
    whole = rows(2000)
    grid, kept = thinned([whole], voxel=voxel)
    for got, expected in zip(kept[:4], plain_means(whole, voxel, grid._anchor), strict=True):
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-11)


@settings(max_examples=30)
@given(st.lists(st.integers(1, 999), max_size=6), st.integers(0, 99))
def test_chunks_do_not_matter_once_cubes_are_there(cuts, seed):
    whole = rows(1500, seed)
    first = whole.where(slice(0, 500))
    bounds = [500, *sorted(500 + cut for cut in cuts), 1500]
    parts = [whole.where(slice(begin, end)) for begin, end in pairwise(bounds)]
    _, once = thinned([first, whole.where(slice(500, None))], voxel=1.0)
    _, often = thinned([first, *parts], voxel=1.0)
    for one, other in zip(once[:4], often[:4], strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)


@pytest.mark.parametrize("at_most", [20, 200, 1999])
def test_cubes_double_until_no_more_than_asked_for_are_left(at_most):
    whole = rows(2000)
    grid, kept = thinned([whole.where(slice(k, k + 100)) for k in range(0, 2000, 100)], at_most=at_most)
    assert 0 < len(kept.points) <= at_most
    exact = plain_means(whole, grid.edge, grid._anchor)
    np.testing.assert_allclose(kept.points, exact[0], rtol=0, atol=1e-11)
    assert "thinned while it was read" in grid.notes()[0]


def test_what_fits_is_kept_as_it_is():
    whole = rows(2000)
    for options in ({"at_most": 2000}, {"at_most": 2000, "voxel": 1.0}, {}):
        grid, kept = thinned([whole.where(slice(0, 700)), whole.where(slice(700, None))], **options)
        assert grid.notes() == ()
        assert all(np.array_equal(one, other) for one, other in zip(kept[:4], whole[:4], strict=True))


def test_points_too_far_to_be_numbered_are_refused_or_left_out_with_a_note():
    whole = rows(1000)
    whole.points[7] = 1e9
    with pytest.raises(ValueError, match=r"voxel: expected at least .* got 0.1"):
        thinned([whole], voxel=0.1)
    grid, kept = thinned([whole], at_most=50)
    assert kept.points.max() < 11
    assert grid.notes()[1].startswith("1 points lie ")


def test_a_cloud_read_whole_is_thinned_like_a_stream():
    whole = rows(3000)
    raw = RawCloud(name="a", format="b", points=whole.points, colors=whole.colors, normals=whole.normals)
    kept = collect(stream_of(raw), thinning=Thinning(voxel=0.002), meters=0.001)
    assert (kept.rows_in_file, kept.voxel, kept.color_depth) == (3000, 0.002, "uint8")
    assert np.abs(kept.points).max() <= 0.01
    assert 0 <= kept.colors.min() < kept.colors.max() <= 1


def write_text(path, rows, header="x y z red green blue"):
    path.write_text("\n".join([header, *(" ".join(map(str, row)) for row in rows), ""]))
    return path


@pytest.mark.parametrize(
    ("colors", "largest"),
    [((0.2, 1.0005), 1.0), ((-1e-8, 0.9), 0.9), ((0, 1), 1.0), ((0.5, 128.5), 128.5 / 255), ((0, 300), 300 / 65535)],
)
def test_colors_of_text_are_scaled_as_those_of_other_files(tmp_path, colors, largest):
    rows = [(k, 0, k % 2, *(colors[(k + c) % 2] for c in range(3))) for k in range(6)]
    file = read_cloud_report(write_text(tmp_path / "a.xyz", rows))
    assert float(file.cloud.colors.max()) == pytest.approx(largest, abs=1e-6)


def test_colors_of_rows_that_are_dropped_do_not_scale_the_others(tmp_path):
    rows = [("nan", 0, 0, 255, 255, 255), (1, 0, 0, 0.2, 0.5, 0.9), (0, 1, 0, 0.4, 0.1, 0.3), (0, 1, 1, 0.4, 0.3, 0.3)]
    header = "ply\nformat ascii 1.0\nelement vertex 4\n" + "".join(
        f"property float {name}\n" for name in ("x", "y", "z", "red", "green", "blue")
    )
    (tmp_path / "a.ply").write_text(header + "end_header\n" + "".join(" ".join(map(str, row)) + "\n" for row in rows))
    write_text(tmp_path / "a.xyz", rows)
    for name in ("a.ply", "a.xyz"):
        for voxel in (None, 1e-4):
            cloud = read_cloud_report(tmp_path / name, reading=Reading(voxel=voxel)).cloud
            assert float(cloud.colors.max()) == pytest.approx(0.9), (name, voxel)


def test_one_color_is_none_thinned_or_not_and_gives_way_to_intensity(tmp_path):
    rows = [(k % 7, k % 5, k % 3, k, 77, 130, 9) for k in range(200)]
    path = write_text(tmp_path / "a.xyz", rows, "x y z intensity red green blue")
    for voxel in (None, 2.3):
        assert read_cloud_report(path, reading=Reading(voxel=voxel)).cloud.colors is None
        gray = read_cloud_report(path, reading=Reading(voxel=voxel, intensity=True)).cloud.colors
        assert float(gray.max()) > 0.9


def test_an_intensity_that_is_no_number_does_not_cost_the_others(tmp_path):
    rows = [(0, 0, 0, 1), (1, 0, 0, "nan"), (0, 1, 0, 3)]
    path = write_text(tmp_path / "a.xyz", rows, "x y z intensity")
    assert read_cloud_report(path, reading=Reading(intensity=True)).cloud.colors is not None
