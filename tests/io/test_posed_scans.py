"""Scans written with poses: what is read back lies in the world where the pose puts it, also far from zero."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from problems import random_transform, seeded, turned
from refusals import refuses
from test_round_trips import SCANNERS, UTM, survey, whole

import torchreg as tr
from torchreg.geometry.se3 import apply, compose, transform
from torchreg.io import PointFields, each_scan, posed_scan, read_scans, write_cloud, write_scans
from torchreg.io.fields import scaled_intensity
from torchreg.io.formats import CAPACITIES, FIELDS_WRITERS, SCANS_WRITERS, WRITERS

FAR = turned(30, (1, 2, 3), (500000.25, 5400000.5, 100.125))


def to_world(seed, far):
    own = random_transform(seeded(seed))
    return compose(FAR, own) if far else own


@pytest.mark.parametrize("suffix", SCANS_WRITERS)
@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 1000),
    count=st.integers(2, 50),
    far=st.tuples(st.booleans(), st.booleans(), st.booleans()),
    scanner=st.sampled_from(SCANNERS),
    with_pose=st.booleans(),
    wide=st.booleans(),
)
def test_scans_with_poses_come_back_in_the_world(tmp_path, suffix, seed, count, far, scanner, with_pose, wide):
    dtype = torch.float64 if wide else torch.float32
    scans, clouds = [], []
    for k, apart in enumerate(far):
        cloud = survey(seed + k, count, origin=UTM if apart else 0 * UTM, scanner=scanner, dtype=dtype)
        pose = to_world(seed + 7, apart) if with_pose else None
        T = to_world(seed + 20 + k, far[0])
        scans.append(posed_scan(cloud, T, pose=pose, name=f"s{k}"))
        clouds.append(transform(cloud.to(dtype=torch.float64), T))
    write_scans(tmp_path / f"a{suffix}", scans)
    files = read_scans(tmp_path / f"a{suffix}", dtype=torch.float64)
    assert len(files) == 3
    for scan, file, cloud in zip(scans, files, clouds, strict=True):
        assert (whole(file.cloud) - whole(cloud)).abs().max() < 1e-6
        assert (file.cloud.colors - cloud.colors).abs().max() <= 0.5001 / 255
        assert (file.pose - scan.T_file_scan).abs().max() < 1e-6
        assert (file.cloud.normals is None) == (not CAPACITIES[suffix].normals)
        if bool(cloud.viewpoint_known[0]):
            assert bool(file.cloud.viewpoint_known[0])
            apart = whole_viewpoint(file.cloud) - whole_viewpoint(cloud)
            assert apart.abs().max() < 1e-6 or with_pose  # then the pose counts


def whole_viewpoint(cloud):
    return cloud.viewpoint.double() + cloud.origin


@pytest.mark.parametrize("suffix", WRITERS)
@pytest.mark.parametrize("far", [False, True])
def test_a_scan_moved_into_the_world_comes_back_to_a_tenth_of_a_millimeter(tmp_path, suffix, far):
    for seed in range(5):
        cloud, T = survey(seed, dtype=torch.float32, origin=0 * UTM), to_world(seed, far)
        fields = PointFields(intensity=torch.linspace(0, 1, 200), scan=torch.arange(200))
        write_cloud(tmp_path / f"a{suffix}", cloud, T=T, fields=fields)
        (file,) = read_scans(tmp_path / f"a{suffix}", dtype=torch.float64)
        assert (whole(file.cloud) - apply(T, cloud.points.double())).abs().max() < 1e-4


def test_a_frame_of_a_scan_has_its_zero_at_the_scanner_or_is_that_of_its_file():
    cloud = survey()
    scan = posed_scan(cloud, torch.eye(4, dtype=torch.float64))
    assert scan.cloud.viewpoint.abs().max() < 1e-9
    assert torch.equal(scan.T_file_scan[:3, 3], whole_viewpoint(cloud)[0])
    pose = to_world(3, True)
    scan = posed_scan(cloud, FAR, pose=pose)
    assert (scan.T_file_scan - compose(FAR, pose)).abs().max() < 1e-8
    nowhere = posed_scan(survey(scanner="none"), torch.eye(4, dtype=torch.float64))
    assert torch.equal(nowhere.T_file_scan[:3, 3], UTM[0])


def test_pye57_reads_poses_and_points(tmp_path):
    import pye57

    clouds, poses = [survey(k) for k in range(3)], [to_world(k, True) for k in range(3)]
    scans = [
        posed_scan(cloud, T, name=f"s{k}", fields=PointFields(intensity=cloud.points[:, 0]))
        for k, (cloud, T) in enumerate(zip(clouds, poses, strict=True))
    ]
    write_scans(tmp_path / "a.e57", iter(scans))
    file = pye57.E57(str(tmp_path / "a.e57"))
    assert file.scan_count == 3
    for k, (cloud, T) in enumerate(zip(clouds, poses, strict=True)):
        data = file.read_scan(k, ignore_missing_fields=True, intensity=True, colors=True)
        points = np.stack([data[f"cartesian{axis}"] for axis in "XYZ"], axis=1)
        np.testing.assert_allclose(points, apply(T, whole(cloud)).numpy(), atol=1e-6)
        np.testing.assert_allclose(data["intensity"], cloud.points[:, 0].numpy(), atol=1e-4)
        assert file.get_header(k)["name"].value() == f"s{k}"
        np.testing.assert_allclose(file.get_header(k).translation, scans[k].T_file_scan[:3, 3].numpy(), atol=1e-8)


@pytest.mark.parametrize("suffix", [suffix for suffix in CAPACITIES if "intensity" in CAPACITIES[suffix].fields])
def test_intensity_is_kept_where_the_row_says_so(tmp_path, suffix):
    cloud = survey(step=1e-3)
    for top in (1.0, 255.0, 65535.0):
        values = (torch.arange(200, dtype=torch.float64) / 199 * top).round() if top > 1 else torch.arange(200) / 199
        fields = PointFields(intensity=values.double())
        if suffix in SCANS_WRITERS:
            write_scans(tmp_path / f"a{suffix}", [posed_scan(cloud, FAR, fields=fields)])
        else:
            write_cloud(tmp_path / f"a{suffix}", cloud, T=FAR, fields=fields)
        losses = [loss for loss in CAPACITIES[suffix].losses(cloud, fields) if "intensity" in loss]
        if suffix == ".ply":  # read by Open3D below, since reading here leaves the intensity out
            assert losses == []
            continue
        (file,) = each_scan(tmp_path / f"a{suffix}", reading=tr.io.Reading(dtype=torch.float64))
        scale = 1.0 if not losses else float(fields.intensity_to(CAPACITIES[suffix].intensity).max()) / top
        assert (file.intensity - scale * values).abs().max() <= 0.5001
        assert bool(losses) == (scale != 1.0)


def test_other_programs_read_the_number_of_the_scan_and_the_intensity(tmp_path):
    import laspy

    from torchreg.open3d_loader import load_open3d

    cloud, fields = survey(), PointFields(intensity=torch.arange(200.0), scan=torch.arange(200) * 300)
    for suffix in (".ply", ".las", ".laz"):
        write_cloud(tmp_path / f"a{suffix}", cloud, fields=fields)
    found = load_open3d().t.io.read_point_cloud(str(tmp_path / "a.ply")).point
    assert found["scan"].numpy()[:, 0].tolist() == fields.scan.tolist()
    assert found["intensity"].numpy()[:, 0].tolist() == fields.intensity.tolist()
    for suffix in (".las", ".laz"):
        with laspy.open(tmp_path / f"a{suffix}") as file:
            points = file.read()
        assert np.asarray(points.point_source_id).tolist() == fields.scan.tolist()
        assert np.asarray(points.intensity).tolist() == fields.intensity.tolist()


def test_what_a_format_has_no_place_for_is_said():
    fields = PointFields(intensity=torch.arange(200.0), scan=torch.arange(200))
    for suffix, keeps in CAPACITIES.items():
        lost = " ".join(keeps.losses(survey(), fields))
        assert ("intensity is left out" in lost) == ("intensity" not in keeps.fields)
        assert ("number of the scan" in lost) == ("scan" not in keeps.fields)
        assert bool(keeps.fields) == (suffix in FIELDS_WRITERS or suffix in SCANS_WRITERS)


@settings(max_examples=50, deadline=None)
@given(values=st.lists(st.floats(-1e5, 1e5), min_size=1, max_size=20), top=st.sampled_from([1.0, 65535.0]))
def test_intensities_keep_their_order_in_any_scale(values, top):
    given_ = np.array(values)
    scaled = scaled_intensity(given_, top)
    assert scaled.min() >= 0
    assert scaled.max() <= top
    order = np.argsort(given_)
    assert (np.diff(scaled[order]) >= 0).all()


def test_a_point_at_the_scanner_of_ptx_is_no_lost_beam(tmp_path):
    cloud = tr.Clouds(torch.tensor([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]]))
    write_scans(tmp_path / "a.ptx", [posed_scan(cloud, FAR)])
    (file,) = read_scans(tmp_path / "a.ptx", dtype=torch.float64)
    assert (whole(file.cloud) - apply(FAR, cloud.points.double())).abs().max() < 1e-6


@pytest.mark.parametrize("scanner", SCANNERS)
@pytest.mark.parametrize("suffix", SCANS_WRITERS)
def test_a_file_that_makes_more_of_the_scanner_than_is_known_says_so(tmp_path, suffix, scanner):
    cloud = survey(scanner=scanner)
    write_scans(tmp_path / f"a{suffix}", [posed_scan(cloud, FAR)])
    (file,) = read_scans(tmp_path / f"a{suffix}")
    claimed = bool(file.cloud.viewpoint_known[0]) and not bool(cloud.viewpoint_known[0])
    assert any("as if it were known" in loss for loss in CAPACITIES[suffix].losses(cloud)) == claimed


def test_what_cannot_be_written_is_refused(tmp_path):
    scan = posed_scan(survey(), FAR)
    with refuses("path", ".e57 or .ptx"):
        write_scans(tmp_path / "a.ply", [scan])
    for suffix in SCANS_WRITERS:
        with refuses("scans", "at least one", "none"):
            write_scans(tmp_path / f"a{suffix}", [])
    with refuses("cloud", "finite"):
        bad = replace(survey(), points=torch.full((200, 3), torch.nan, dtype=torch.float64))
        write_scans(tmp_path / "a.ptx", [posed_scan(bad, FAR)])
    with refuses("fields, scan", "(200,)"):
        write_cloud(tmp_path / "a.ply", survey(), fields=PointFields(scan=torch.arange(3)))
    with refuses("scan", "0 to 65535"):
        PointFields(scan=torch.tensor([65536]))
    assert list(tmp_path.iterdir()) == []
