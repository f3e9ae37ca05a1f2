"""Gaussian splats as PLY: centers, colors of the constant harmonic, faint ones dropped."""

import numpy as np
import pytest
import torch
from hand_made_files import PLY_ENCODINGS, named, write_ply

from torchreg.errors import CloudFileError
from torchreg.io import read_cloud_report

NAMES = ("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "f_rest_0", "opacity", "scale_0", "rot_0")


def splats(count=200, seed=0):
    values = np.random.default_rng(seed).normal(size=(count, len(NAMES)))
    values[:, 3:6] = 0
    values[:, 10] *= 4
    return values.astype("f4")


@pytest.mark.parametrize("encoding", PLY_ENCODINGS)
def test_centers_and_colors_of_splats_that_are_not_faint(tmp_path, encoding):
    values = splats()
    file = read_cloud_report(write_ply(tmp_path / "a.ply", named(NAMES, values, "f4"), encoding))
    opaque = 1 / (1 + np.exp(-values[:, 10].astype(float))) >= 0.1
    assert 0 < (~opaque).sum() < 200
    np.testing.assert_array_equal(file.cloud.points.numpy(), values[opaque, :3])
    colors = np.clip(0.5 + values[opaque, 6:9] * 0.28209479177387814, 0, 1)
    np.testing.assert_allclose(file.cloud.colors.numpy(), colors, rtol=0, atol=1e-6)
    assert not file.has_normals
    assert file.notes == (f"{(~opaque).sum()} of 200 splats have an opacity below 0.1 and were left out",)
    assert file.format == f"ply {encoding}, Gaussian splats"


def test_a_cloud_of_faint_splats_keeps_them_all(tmp_path):
    values = splats()
    values[:, 10] = -9
    file = read_cloud_report(write_ply(tmp_path / "a.ply", named(NAMES, values, "f4")))
    assert len(file.cloud.points) == 200
    assert "none was left out" in file.notes[0]


def test_what_is_no_number_costs_no_more_than_itself(tmp_path):
    values = splats()
    values[0, 10], values[1, 7], values[2, 0] = np.nan, np.inf, np.nan
    values[:3, 10] = 5
    file = read_cloud_report(write_ply(tmp_path / "a.ply", named(NAMES, values, "f4")))
    assert file.dropped_non_finite == 1
    assert bool(torch.isfinite(file.cloud.colors).all())


def test_splats_without_centers_are_refused(tmp_path):
    columns = {name: column for name, column in named(NAMES, splats(), "f4").items() if name != "z"}
    with pytest.raises(CloudFileError, match="x, y, z"):
        read_cloud_report(write_ply(tmp_path / "a.ply", columns))
