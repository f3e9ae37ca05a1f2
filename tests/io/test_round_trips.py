"""What every writer of the table writes comes back: to 0.1 mm, and but for what its row says it leaves out."""

import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from torchreg.io import read_cloud, read_cloud_report, write_cloud
from torchreg.io.formats import CAPACITIES, READERS, WRITERS
from torchreg.io.las_writer import las_step
from torchreg.io.pcd_writer import pcd_step
from torchreg.types import Clouds

UTM = torch.tensor([[500000.0, 5400000.0, 100.0]], dtype=torch.float64)
SCANNERS = ("known", "known zero", "assumed", "none")
SUFFIXES = tuple(suffix for suffix in WRITERS if suffix in READERS)


def survey(seed=0, count=200, *, origin=UTM, extent=80.0, step=1e-3, dtype=torch.float64, scanner="known", fields=True):
    """A cloud of whole steps, by default millimeters, with all that a cloud may have."""
    g = torch.Generator().manual_seed(seed)
    points = (torch.rand(count, 3, generator=g, dtype=torch.float64) * extent / step).round() * step
    normals = torch.nn.functional.normalize(torch.randn(count, 3, generator=g, dtype=torch.float64), dim=1)
    colors = torch.randint(0, 256, (count, 3), generator=g) / 255
    colors[0] = torch.tensor([1.0, 0.5, 0.001])  # one that is no whole level
    viewpoint = torch.tensor([[extent / 2, extent / 3, 1.712]], dtype=torch.float64)
    viewpoint = {"known zero": -origin, "none": None}.get(scanner, viewpoint)
    cloud = Clouds(
        points=points,
        colors=colors.to(points.dtype) if fields else None,
        normals=normals if fields else None,
        origin=origin,
        viewpoint=viewpoint,
        viewpoint_assumed=torch.tensor([scanner == "assumed"]),
    )
    return cloud.to(dtype=dtype)


def whole(cloud):
    return cloud.points.double() + cloud.origin


def back_from(tmp_path, suffix, cloud, dtype=torch.float64):
    write_cloud(tmp_path / f"a{suffix}", cloud)
    return read_cloud(tmp_path / f"a{suffix}", dtype=dtype)


def same_scanner(back, cloud):
    assert back.viewpoint_known.tolist() == cloud.viewpoint_known.tolist()
    assert back.viewpoint_assumed.tolist() == cloud.viewpoint_assumed.tolist()
    assert (back.viewpoint is None) == (cloud.viewpoint is None)
    if cloud.viewpoint is not None:
        apart = back.viewpoint.double() + back.origin - cloud.viewpoint.double() - cloud.origin
        assert apart.abs().max() < 1e-6


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("scanner", SCANNERS)
@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 1000), count=st.integers(2, 60), far=st.booleans(), wide=st.booleans(), fields=st.booleans())
def test_a_survey_comes_back(tmp_path, suffix, scanner, seed, count, far, wide, fields):
    dtype = torch.float64 if wide else torch.float32
    cloud = survey(seed, count, step=1e-6, origin=UTM if far else 0 * UTM, dtype=dtype, scanner=scanner, fields=fields)
    back, keeps = back_from(tmp_path, suffix, cloud), CAPACITIES[suffix]
    assert (whole(back) - whole(cloud)).abs().max() < 1e-4
    if not any("coordinates" in loss for loss in keeps.losses(cloud)) and not far:
        assert (whole(back).to(dtype) - cloud.points).abs().max() < 1e-12
    assert (back.colors is None) == (not fields)
    assert (back.normals is None) == (not fields or not keeps.normals)
    if fields:
        limit = 1e-12 if keeps.brightest is None else 0.5001 / keeps.brightest
        assert (back.colors - cloud.colors.double()).abs().max() <= limit
    if back.normals is not None:
        assert (back.normals - cloud.normals.double()).abs().max() < 1e-6
    if keeps.scanner:
        same_scanner(back, cloud)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_what_a_row_calls_kept_is_kept_and_what_it_calls_lost_is_lost(tmp_path, suffix):
    cloud, keeps = survey(), CAPACITIES[suffix]
    back = back_from(tmp_path, suffix, cloud)
    lost = " ".join(keeps.losses(cloud))
    assert ("normals" in lost) == (back.normals is None)
    assert ("scanner" in lost) == (not bool(back.viewpoint_known[0]))
    moved = (whole(back) - whole(cloud)).abs().max()
    assert moved < 1e-8 or "coordinates" in lost
    assert ("colors" in lost) == ((back.colors - cloud.colors).abs().max() > 1e-6)
    bare = Clouds(points=cloud.points, origin=cloud.origin)
    assert len(keeps.losses(bare)) == ("coordinates" in lost)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_what_came_back_comes_back_again(tmp_path, suffix):
    """The second time nothing changes: no step, level or origin wanders."""
    once = back_from(tmp_path, suffix, survey())
    twice = back_from(tmp_path, suffix, once)
    assert (whole(twice) - whole(once)).abs().max() < 1e-8
    assert torch.equal(twice.colors, once.colors)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_one_point_and_equal_points_come_back(tmp_path, suffix):
    for points in (torch.tensor([[1.5, 2.25, -3.125]]), torch.full((7, 3), 4.5)):
        back = back_from(tmp_path, suffix, Clouds(points=points, origin=UTM))
        assert (whole(back) - points - UTM).abs().max() < 1e-4


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_transform_moves_what_is_written(tmp_path, suffix):
    cloud = survey()
    T = torch.eye(4, dtype=torch.float64)
    T[:3, :3] = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    T[:3, 3] = torch.tensor([5900000.25, 4899990.5, 3.0])
    write_cloud(tmp_path / f"a{suffix}", cloud, T=T)
    back = read_cloud(tmp_path / f"a{suffix}", dtype=torch.float64)
    assert (whole(back) - (whole(cloud) @ T[:3, :3].T + T[:3, 3])).abs().max() < 1e-4


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_the_documentation_names_every_suffix(suffix):
    assert re.search(rf"^    (\.\w+ )*\{suffix}\b", write_cloud.__doc__, re.MULTILINE)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_clouds_without_points_or_finite_ones_end_in_a_file_or_a_value_error(tmp_path, suffix):
    for points in (torch.zeros(0, 3), torch.tensor([[0.0, 1.0, torch.nan], [1.0, 2.0, 3.0]])):
        path = tmp_path / f"a{len(points)}{suffix}"
        try:
            write_cloud(path, Clouds(points=points))
        except ValueError as error:
            assert str(error).startswith("cloud: expected finite points")  # noqa: PT017  # a file is as good
            assert not path.exists()
            continue
        assert path.exists()
        if len(points):
            assert read_cloud_report(path).dropped_non_finite == 1
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


@pytest.mark.parametrize(("extent", "step"), [(80.0, 1e-5), (150.0, 1e-4), (0.5, 1e-7), (3e5, 1e-4), (3e6, 1e-3)])
@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_steps_of_las_follow_the_extent(tmp_path, suffix, extent, step):
    import laspy

    points = torch.rand(50, 3, dtype=torch.float64) * extent
    points[0], points[1] = 0, extent
    cloud = Clouds(points=points, origin=UTM)
    back = back_from(tmp_path, suffix, cloud)
    assert las_step(cloud) == step
    assert (whole(back) - whole(cloud)).abs().max() <= step * 0.5001 + 2e-9  # the last digit of a double at 5,400 km
    with laspy.open(tmp_path / f"a{suffix}") as file:
        assert file.header.scales.tolist() == [step] * 3
        assert file.header.are_points_compressed == (suffix == ".laz")


def test_other_programs_read_pcd(tmp_path):
    from torchreg.open3d_loader import load_open3d

    o3d = load_open3d()
    for cloud in (survey(), survey(origin=0 * UTM), survey(origin=0 * UTM, dtype=torch.float32)):
        write_cloud(tmp_path / "a.pcd", cloud)
        found = o3d.t.io.read_point_cloud(str(tmp_path / "a.pcd")).point
        np.testing.assert_allclose(found.positions.numpy(), whole(cloud).numpy(), atol=1e-5)
        np.testing.assert_allclose(found.colors.numpy() / 255.0, cloud.colors.numpy(), atol=0.6 / 255)
        np.testing.assert_allclose(found.normals.numpy(), cloud.normals.numpy(), atol=1e-6)
    points = o3d.io.read_point_cloud(str(tmp_path / "a.pcd")).points  # the older reader takes no doubles
    np.testing.assert_allclose(np.asarray(points), whole(cloud).numpy(), atol=1e-5)


def test_pcd_says_what_floats_of_four_bytes_round(tmp_path):
    near, exact = survey(origin=0 * UTM), survey(origin=0 * UTM, dtype=torch.float32)
    step = pcd_step(near)
    moved = (whole(back_from(tmp_path, ".pcd", near)) - whole(near)).abs().max()
    assert 0 < moved <= step / 2 < 1e-5
    assert pcd_step(exact) is None
    assert pcd_step(survey()) is None


def test_numpy_reads_text(tmp_path):
    cloud = survey()
    for suffix, words in ((".xyz", {}), (".csv", {"delimiter": ",", "skiprows": 1})):
        write_cloud(tmp_path / f"a{suffix}", cloud)
        table = np.loadtxt(tmp_path / f"a{suffix}", **words)
        np.testing.assert_array_equal(table[:, :3], whole(cloud).numpy())
        assert table.shape == (200, 9)
    words = (tmp_path / "a.xyz").read_text().splitlines()[2].split()
    assert all(len(word.partition(".")[2]) <= 3 for word in words[:3])  # millimeters went in


@pytest.mark.parametrize("scanner", SCANNERS)
def test_pye57_reads_e57(tmp_path, scanner):
    import pye57

    cloud = survey(scanner=scanner)
    write_cloud(tmp_path / "a.e57", cloud)
    file = pye57.E57(str(tmp_path / "a.e57"))
    header = file.get_header(0)
    assert header.has_pose() == scanner.startswith("known")
    if scanner.startswith("known"):
        np.testing.assert_allclose(header.translation, (cloud.viewpoint + cloud.origin)[0].numpy(), atol=1e-9)
    data = file.read_scan(0, ignore_missing_fields=True, colors=True)
    points = np.stack([data[f"cartesian{axis}"] for axis in "XYZ"], axis=1)
    np.testing.assert_allclose(points, whole(cloud).numpy(), atol=1e-8)
    colors = np.stack([data[f"color{name}"] for name in ("Red", "Green", "Blue")], axis=1)
    np.testing.assert_allclose(colors / 255, cloud.colors.numpy(), atol=0.6 / 255)


def test_long_clouds_are_written_to_the_last_row(tmp_path, monkeypatch):
    monkeypatch.setattr("torchreg.io.e57_writer.CHUNK_ROWS", 64)
    cloud = survey()
    assert (whole(back_from(tmp_path, ".e57", cloud)) - whole(cloud)).abs().max() < 1e-8


@pytest.mark.parametrize(("suffix", "name"), [(".e57", "pye57"), (".laz", "laspy")])
def test_without_the_package_the_message_says_how_to_get_it(tmp_path, monkeypatch, suffix, name):
    monkeypatch.setitem(__import__("sys").modules, name, None)
    with pytest.raises(ValueError, match=rf"expected the package {name}, for such files \(pip install"):
        write_cloud(tmp_path / f"a{suffix}", survey())
    assert list(tmp_path.iterdir()) == []


def test_16_bit_colors_survive_las(tmp_path):
    levels = torch.randint(0, 65536, (50, 3), dtype=torch.int64)
    levels[0] = 65535
    cloud = replace(survey(count=50), colors=levels.double() / 65535)
    assert torch.equal((back_from(tmp_path, ".las", cloud).colors * 65535).round().long(), levels)
