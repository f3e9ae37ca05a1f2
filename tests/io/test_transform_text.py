"""Transforms as text."""

import json

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from torchreg.errors import CloudFileError
from torchreg.io import read_transform_text, write_transform_text


def rigid(seed):
    rng = np.random.default_rng(seed)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = q * np.linalg.det(q), rng.normal(size=3) * 1e6
    return torch.from_numpy(T)


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10_000))
def test_text_keeps_every_bit(tmp_path, seed):
    T = rigid(seed)
    write_transform_text(tmp_path / "T.txt", T)
    assert torch.equal(read_transform_text(tmp_path / "T.txt"), T)
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "T.txt"), T.numpy())


def test_json_and_comments(tmp_path):
    T = rigid(3)
    (tmp_path / "a.json").write_text(json.dumps({"T_target_source": T.tolist(), "other": 1}))
    assert torch.equal(read_transform_text(tmp_path / "a.json"), T)
    (tmp_path / "b.txt").write_text("# note\n\n1 0 0 0\n0 1 0 0 # y\n0 0 1 0\n0 0 0 1\n\n")
    assert torch.equal(read_transform_text(tmp_path / "b.txt"), torch.eye(4, dtype=torch.float64))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a file with content"),
        ("1 0 0\n0 1 0\n0 0 1\n", "4 lines of 4 numbers"),
        ("1 0 0 0\n0 1 0 0\n0 0 1 0\n", "4 lines of 4 numbers"),
        ("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 a\n", "could not convert"),
        ("1 0 0 nan\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", "finite numbers"),
        ("2 0 0 0\n0 2 0 0\n0 0 2 0\n0 0 0 1\n", "a rotation"),
        ("-1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", "determinant 1, got a reflection, R R^T off by 0, determinant -1"),
        ("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 1 1\n", "a last row 0 0 0 1"),
        ("{", "valid JSON"),
        ("{}", "the key 'T_target_source', got no key"),
        ('{"T_target_source": [[1, 2], [3]]}', "(4, 4) numbers"),
        ('{"T_target_source": {"a": 1}}', "(4, 4) numbers"),
        ('{"T_target_source": null}', "(4, 4) numbers"),
        ('{"success": false, "T_target_source": []}', "a registration that succeeded"),
        ("\0\1\2\xff", "4 lines of 4 numbers"),
    ],
)
def test_refused(tmp_path, text, message):
    path = tmp_path / "T.txt"
    path.write_text(text)
    with pytest.raises(CloudFileError) as caught:
        read_transform_text(path)
    assert str(caught.value).startswith(f"{path}: expected ")
    assert message in str(caught.value)


def test_tolerance_and_missing(tmp_path):
    path = tmp_path / "T.txt"
    rounded = rigid(5)
    rounded[:3, :3] = rounded[:3, :3].round(decimals=5)
    np.savetxt(path, rounded)
    assert torch.equal(read_transform_text(path), rounded)
    rounded[0, 0] += 3e-4
    np.savetxt(path, rounded)
    with pytest.raises(CloudFileError, match="a rotation"):
        read_transform_text(path)
    with pytest.raises(CloudFileError, match="nothing of this name"):
        read_transform_text(tmp_path / "none.txt")
    with pytest.raises(ValueError, match=r"^T: expected a rotation"):
        write_transform_text(path, rounded)
