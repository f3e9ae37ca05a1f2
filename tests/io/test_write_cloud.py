"""What is written comes back, in full or not at all."""

import os
import signal
import subprocess
import sys

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from torchreg.io import read_cloud, read_cloud_report, write_cloud
from torchreg.io.atomic import atomic_write, remove_remains
from torchreg.types import Clouds

UTM = torch.tensor([[512345.0, 5234567.0, 431.0]], dtype=torch.float64)


def some_cloud(dtype=torch.float32, origin=None, count=50, seed=0, **more):
    g = torch.Generator().manual_seed(seed)
    normals = torch.randn(count, 3, generator=g, dtype=dtype)
    return Clouds(
        points=torch.rand(count, 3, generator=g, dtype=dtype) * 8 - 4,
        colors=torch.randint(0, 256, (count, 3), generator=g).to(dtype) / 255,
        normals=normals / normals.norm(dim=1, keepdim=True),
        origin=origin,
        viewpoint=torch.tensor([[1.0, -2.0, 0.5]], dtype=dtype),
        **more,
    )


def rotation(seed=1):
    g = torch.Generator().manual_seed(seed)
    q, _ = torch.linalg.qr(torch.randn(3, 3, generator=g, dtype=torch.float64))
    T = torch.eye(4, dtype=torch.float64)
    T[:3, :3] = q * torch.linalg.det(q)
    T[:3, 3] = torch.tensor([10.0, -3.0, 0.25])
    return T


def same(a, b):
    for name in ("points", "colors", "normals", "origin", "viewpoint"):
        left, right = getattr(a, name), getattr(b, name)
        assert (left is None) == (right is None), name
        assert left is None or torch.equal(left, right), name


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("origin", [None, UTM])
@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 1000), count=st.integers(1, 40))
def test_npz_is_exact(tmp_path, dtype, origin, seed, count):
    cloud = some_cloud(dtype, origin, count, seed)
    write_cloud(tmp_path / "a.npz", cloud)
    back = read_cloud(tmp_path / "a.npz", dtype=dtype)
    for name in ("points", "colors", "origin", "viewpoint"):
        assert torch.equal(getattr(back, name), getattr(cloud, name)), name
    torch.testing.assert_close(back.normals, cloud.normals)  # brought to length one once more


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_ply_of_an_ordinary_scan_is_exact(tmp_path, dtype):
    cloud = some_cloud(dtype)
    write_cloud(tmp_path / "a.ply", cloud)
    back = read_cloud(tmp_path / "a.ply", dtype=dtype)
    for name in ("points", "colors", "origin", "viewpoint"):
        assert torch.equal(getattr(back, name), getattr(cloud, name)), name
    torch.testing.assert_close(back.normals, cloud.normals, atol=1e-7, rtol=0)
    word = b"property double x" if dtype == torch.float64 else b"property float x"
    assert word in (tmp_path / "a.ply").read_bytes()


@pytest.mark.parametrize("shift", [0.0, 5000.0])
def test_ply_of_large_coordinates_keeps_a_micrometer(tmp_path, shift):
    cloud = some_cloud(origin=UTM if shift == 0 else None)
    cloud = Clouds(points=cloud.points + shift, origin=cloud.origin, viewpoint=cloud.viewpoint + shift)
    write_cloud(tmp_path / "a.ply", cloud)
    back = read_cloud(tmp_path / "a.ply")
    assert (back.points + back.origin - cloud.points - cloud.origin).abs().max() < 1e-6
    assert (back.viewpoint + back.origin - cloud.viewpoint - cloud.origin).abs().max() < 1e-6
    assert back.colors is None
    assert back.normals is None


@pytest.mark.parametrize("name", ["a.ply", "a.npz"])
def test_an_unknown_viewpoint_stays_unknown(tmp_path, name):
    for viewpoint in (None, torch.full((1, 3), float("nan"))):
        write_cloud(tmp_path / name, Clouds(torch.rand(5, 3), viewpoint=viewpoint))
        assert read_cloud(tmp_path / name).viewpoint is None


@pytest.mark.parametrize("name", ["a.ply", "a.npz"])
@pytest.mark.parametrize("T", [None, rotation()])
@pytest.mark.parametrize("origin", [None, UTM])
@pytest.mark.parametrize("assumed", [True, False])
def test_a_viewpoint_comes_back_as_known_or_assumed_as_it_was(tmp_path, name, T, origin, assumed):
    cloud = some_cloud(origin=origin, viewpoint_assumed=torch.tensor([assumed]))
    for _ in range(2):
        write_cloud(tmp_path / name, cloud, T=T)
        cloud = read_cloud(tmp_path / name)
        assert cloud.viewpoint_assumed.tolist() == [assumed]
        assert cloud.viewpoint_known.tolist() == [not assumed]
    report = read_cloud_report(tmp_path / name)
    assert report.viewpoint_source == ("assumed, as the file says" if assumed else "the file")
    assert read_cloud(tmp_path / name, viewpoint="origin").viewpoint_known.tolist() == [True]


@pytest.mark.parametrize("name", ["a.ply", "a.npz"])
@pytest.mark.parametrize("origin", [None, UTM])
def test_a_transform_moves_points_normals_and_viewpoint_in_float64(tmp_path, name, origin):
    cloud, T = some_cloud(origin=origin), rotation()
    write_cloud(tmp_path / name, cloud, T=T)
    back = read_cloud(tmp_path / name)
    naive = (cloud.points + cloud.origin) @ T[:3, :3].T + T[:3, 3]
    assert (back.points + back.origin - naive).abs().max() < 2e-6
    seen_from = (cloud.viewpoint + cloud.origin) @ T[:3, :3].T + T[:3, 3]
    assert (back.viewpoint + back.origin - seen_from).abs().max() < 2e-6
    torch.testing.assert_close(back.normals.double(), cloud.normals.double() @ T[:3, :3].T, atol=1e-6, rtol=0)
    assert torch.equal(back.colors, cloud.colors)


def test_colors_are_rounded_and_cut_off(tmp_path):
    colors = torch.tensor([[-0.1, 0.5, 1.2], [0.001, 0.9999, 1.0]])
    write_cloud(tmp_path / "a.ply", Clouds(torch.rand(2, 3), colors=colors))
    back = (read_cloud(tmp_path / "a.ply").colors * 255).round().int()
    assert back.tolist() == [[0, 128, 255], [0, 255, 255]]


def test_a_cloud_with_gradients_is_written(tmp_path):
    write_cloud(tmp_path / "a.ply", Clouds(torch.rand(2, 3, requires_grad=True)))
    write_cloud(tmp_path / "a.npz", Clouds(torch.rand(2, 3, requires_grad=True)), T=torch.eye(4))


def test_open3d_reads_what_is_written(tmp_path):
    from torchreg.open3d_loader import load_open3d

    cloud = some_cloud(origin=UTM)
    write_cloud(tmp_path / "a.ply", cloud)
    read = load_open3d().io.read_point_cloud(str(tmp_path / "a.ply"))
    np.testing.assert_allclose(np.asarray(read.points), (cloud.points + cloud.origin).numpy(), atol=1e-9)
    np.testing.assert_allclose(np.asarray(read.colors), cloud.colors.numpy(), atol=1e-7)


def test_bad_arguments(tmp_path):
    cloud = some_cloud()
    with pytest.raises(ValueError, match=r"^path: expected a name that ends in .ply, .* or .npz, got "):
        write_cloud(tmp_path / "a.ptx", cloud)
    with pytest.raises(ValueError, match=r"^path: expected a file in a folder that exists, got "):
        write_cloud(tmp_path / "no" / "a.ply", cloud)
    with pytest.raises(ValueError, match=r"^cloud: expected a batch of one .*, got 2 clouds"):
        write_cloud(tmp_path / "a.ply", Clouds.pack([cloud, cloud]))
    for T in (
        torch.eye(3),
        torch.zeros(4, 4),
        -torch.eye(4),
        torch.eye(4) * 1.01,
        torch.full((4, 4), torch.nan),
    ):
        with pytest.raises(ValueError, match=r"^T: expected .*, got "):
            write_cloud(tmp_path / "a.ply", cloud, T=T)
    (tmp_path / "f.ply").mkdir()
    with pytest.raises(ValueError, match=r"^path: expected a file, got "):
        write_cloud(tmp_path / "f.ply", cloud)
    assert os.listdir(tmp_path) == ["f.ply"]


def test_an_error_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def interrupted():
        with atomic_write(path) as file:
            file.write(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]
    with atomic_write(path) as file:
        file.write(b"new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert os.listdir(tmp_path) == ["a.txt"]


@pytest.mark.skipif(sys.platform == "win32", reason="kills by a signal")
def test_a_killed_writer_leaves_no_half_file(tmp_path):
    code = (
        "import os, signal, sys\n"
        "from torchreg.io.atomic import atomic_write\n"
        "with atomic_write(sys.argv[1]) as file:\n"
        "    file.write(b'x' * 100_000)\n"
        "    file.flush()\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    path = tmp_path / "a.txt"
    path.write_text("old")
    done = subprocess.run([sys.executable, "-c", code, str(path)], check=False)
    assert done.returncode == -signal.SIGKILL
    assert path.read_text() == "old"


@pytest.mark.skipif(sys.platform == "win32", reason="links and permissions of POSIX")
def test_links_and_permissions_are_kept(tmp_path):
    (tmp_path / "real").mkdir()
    real, link = tmp_path / "real" / "a.txt", tmp_path / "a.txt"
    real.write_text("old")
    link.symlink_to(real)
    with atomic_write(link) as file:
        file.write(b"new")
    assert link.is_symlink()
    assert real.read_text() == "new"
    plain = tmp_path / "plain"
    plain.touch()
    assert real.stat().st_mode == plain.stat().st_mode


@pytest.mark.skipif(sys.platform == "win32", reason="links of POSIX")
@pytest.mark.parametrize("kind", ["file", "folder", "nothing", "itself"])
def test_a_link_is_replaced_where_none_is_followed(tmp_path, kind):
    victim, link = tmp_path / "victim", tmp_path / "a.txt"
    if kind == "file":
        victim.write_text("precious")
    elif kind == "folder":
        victim.mkdir()
    link.symlink_to(link if kind == "itself" else victim)
    with atomic_write(link, through_link=False) as file:
        file.write(b"new")
    assert not link.is_symlink()
    assert link.read_text() == "new"
    assert (victim.read_text() if victim.is_file() else victim.is_dir()) == {"file": "precious", "folder": True}.get(
        kind, False
    )


def test_a_temporary_file_takes_no_name_that_is_taken(tmp_path, monkeypatch):
    """Not that of a file, nor of a link planted there: neither is written, nor removed afterwards."""
    monkeypatch.setattr("torchreg.io.atomic.secrets.token_hex", lambda _: "00c0ffee")
    victim, part = tmp_path / "victim", tmp_path / ".a.txt.00c0ffee.tmp"
    victim.write_text("precious")
    part.symlink_to(victim)
    with pytest.raises(FileExistsError), atomic_write(tmp_path / "a.txt") as file:
        file.write(b"new")
    assert part.is_symlink()
    assert victim.read_text() == "precious"
    assert not (tmp_path / "a.txt").exists()


def test_only_what_killed_writers_left_is_removed(tmp_path):
    kept = [".other.tmp", "a.00c0ffee.tmp", ".a.txt.00c0ffee", ".a.txt.00C0FFEE.tmp", ".00c0ffee.tmp"]
    for name in [*kept, ".a.txt.00c0ffee.tmp", ".a.01234567.tmp"]:
        (tmp_path / name).write_text("")
    (tmp_path / ".folder.00c0ffee.tmp").mkdir()
    remove_remains(tmp_path)
    assert sorted(os.listdir(tmp_path)) == sorted([*kept, ".folder.00c0ffee.tmp"])
    (tmp_path / ".a.01234567.tmp").write_text("")
    remove_remains(tmp_path, older_than=3600.0)
    assert (tmp_path / ".a.01234567.tmp").exists()
