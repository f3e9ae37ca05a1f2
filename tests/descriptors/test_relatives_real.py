"""Descriptors of the literature on real scans: a rigid motion changes hardly a row."""

import json
from pathlib import Path

import pytest
import torch
from problems import random_transform

import torchreg as tr

REAL = Path(__file__).parents[2].parent / "shared" / "data" / "real"
RELATIVES = {
    "pfh": tr.pfh,
    "pfhrgb": tr.pfhrgb,
    "spin images": tr.spin_images,
    "shape context": tr.shape_context,
}


def real_cloud(name):
    if not (REAL / "pairs.json").exists():
        pytest.skip("no real pairs beside the checkout")
    pairs = json.loads((REAL / "pairs.json").read_text())["pairs"]
    voxel = next(pair["voxel_m"] for pair in pairs if name in (pair["source"], pair["target"]))
    cloud = tr.voxel_downsample(tr.read_cloud(REAL / name), voxel)
    return tr.estimate_normals(cloud, tr.neighbors(cloud, 2 * voxel, 30)), 5 * voxel


@pytest.mark.real
@pytest.mark.parametrize("name", ["ist_office/frame_18.ply", "sceaux_outdoor/frag_06.ply"])
@pytest.mark.parametrize("describe", RELATIVES.values(), ids=RELATIVES)
def test_a_rigid_motion_changes_hardly_a_row(describe, name):
    cloud, radius = real_cloud(name)
    moved = tr.transform(cloud, random_transform(torch.Generator().manual_seed(4)))
    one, other = (describe(each, tr.neighbors(each, radius, 60)).values for each in (cloud, moved))
    gap = (one - other).abs().amax(dim=1) / one.abs().amax(dim=1).clamp(min=1e-9)
    # points with the same neighbors have the same normal, and rounding decides which of them comes first
    assert float((gap > 0.02).double().mean()) < 0.02
    assert float(gap.median()) < 1e-3
