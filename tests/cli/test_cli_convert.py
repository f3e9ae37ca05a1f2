"""``convert``: what is read in one format is written in another, and what that cannot hold is said."""

import numpy as np
import pytest
import torch
from made_e57 import write_e57

import torchreg as tr
from torchreg.io.formats import WRITERS

UTM = torch.tensor([[500000.0, 5400000.0, 100.0]], dtype=torch.float64)


def converted(run, *words):
    ended = run("convert", *words)
    assert ended.exit_code == 0, ended.output
    return ended.stdout


@pytest.fixture
def survey(tmp_path):
    """A georeferenced cloud with all that a cloud may have, and its file."""
    g = torch.Generator().manual_seed(3)
    cloud = tr.Clouds(
        points=(torch.rand(300, 3, generator=g, dtype=torch.float64) * 40000).round() / 1000,
        colors=torch.randint(0, 256, (300, 3), generator=g).double() / 255,
        normals=torch.nn.functional.normalize(torch.randn(300, 3, generator=g, dtype=torch.float64), dim=1),
        origin=UTM,
        viewpoint=torch.full((1, 3), 1.5, dtype=torch.float64),
    )
    tr.write_cloud(tmp_path / "survey.npz", cloud)
    return tmp_path / "survey.npz", cloud


@pytest.mark.parametrize("suffix", WRITERS)
def test_a_survey_goes_there_and_back(run, tmp_path, survey, suffix):
    path, cloud = survey
    shown = converted(run, path, tmp_path / f"b{suffix}")
    assert f"b{suffix}: 300 of 300 points, colors, normals, scanner known; read as npz" in shown
    assert ("normals are left out" in shown) == (suffix in (".las", ".laz"))
    assert ("scanner, which is known, is left out" in shown) == (suffix in (".las", ".laz", ".csv"))
    converted(run, tmp_path / f"b{suffix}", tmp_path / "c.ply")
    back = tr.read_cloud(tmp_path / "c.ply", dtype=torch.float64)
    assert (back.points + back.origin - cloud.points - cloud.origin).abs().max() < 1e-4
    assert (back.colors - cloud.colors).abs().max() < 1e-6


def test_single_precision_stays_single_and_digits_are_not_lost(run, tmp_path):
    single = tr.Clouds(points=torch.rand(50, 3))
    tr.write_cloud(tmp_path / "a.ply", single)
    assert "not kept" not in converted(run, tmp_path / "a.ply", tmp_path / "b.ply")
    assert b"property float x" in (tmp_path / "b.ply").read_bytes()
    np.savetxt(tmp_path / "a.xyz", torch.rand(50, 3, dtype=torch.float64).numpy(), fmt="%.12f")
    converted(run, tmp_path / "a.xyz", tmp_path / "c.ply")
    assert b"property double x" in (tmp_path / "c.ply").read_bytes()
    words = converted(run, tmp_path / "a.xyz", tmp_path / "c.pcd")
    assert "not kept: coordinates are rounded to steps of 6e-08 m" in words


def test_options_of_reading(run, tmp_path):
    points = np.random.default_rng(0).uniform(0, 3000, (300, 3))
    np.savetxt(tmp_path / "a.txt", np.concatenate([points[:, ::-1], np.arange(300)[:, None]], axis=1), fmt="%.17g")
    words = (tmp_path / "a.txt", tmp_path / "b.npz", "--columns", "z y x intensity", "--units", "mm")
    assert "not kept: the intensity is left out" in converted(run, *words)
    back = tr.read_cloud(tmp_path / "b.npz", dtype=torch.float64)
    np.testing.assert_allclose(back.points.numpy(), points / 1000, rtol=1e-12)
    assert back.colors is None
    shown = converted(run, *words, "--intensity", "--voxel", "1", "--viewpoint", "1,2,3")
    assert "left out" not in shown
    back = tr.read_cloud(tmp_path / "b.npz")
    assert 8 <= len(back.points) < 100
    assert back.colors is not None
    assert (back.viewpoint.tolist(), back.viewpoint_known.tolist()) == ([[1, 2, 3]], [True])


def test_one_scan_of_several(run, tmp_path):
    axes = ("cartesianX", "cartesianY", "cartesianZ")
    scans = [
        {"fields": dict(zip(axes, np.random.default_rng(k).random((3, 9)), strict=True)), "name": name}
        for k, name in enumerate(("hall", "yard"))
    ]
    path = write_e57(tmp_path / "a.e57", scans)
    converted(run, path, tmp_path / "b.xyz", "--scan", "yard")
    back = tr.read_cloud(tmp_path / "b.xyz", dtype=torch.float64)
    np.testing.assert_array_equal(back.points.numpy().T, np.random.default_rng(1).random((3, 9)))
    ended = run("convert", path, tmp_path / "c.xyz")
    assert ended.exit_code == 2
    assert "a file of 2 scans (0 'hall', 1 'yard')" in ended.stderr
    assert not (tmp_path / "c.xyz").exists()


def test_bad_usage(run, tmp_path, survey):
    path, _ = survey
    for target, message in (("b.ptx", "TO: expected a name that ends in"), ("survey.npz", "TO: expected a file of")):
        ended = run("convert", path, tmp_path / target)
        assert ended.exit_code == 2
        assert message in ended.stderr
    ended = run("convert", path, tmp_path / "b.ply", "--voxel", "0")
    assert ended.exit_code == 2
    assert "voxel: expected" in ended.stderr
    assert sorted(one.name for one in tmp_path.iterdir()) == ["survey.npz"]
