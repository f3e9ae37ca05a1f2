"""A large cloud described in tiles gets the bits that it gets as a whole."""

from dataclasses import replace

import pytest
import torch
from determinism import same_bits

import torchreg as tr
from torchreg.registration import describe
from torchreg.registration.tiles import reach_of, tiles_of


@pytest.fixture(scope="module")
def cloud():
    scan = tr.datasets.mall(seed=3, angular_step=2.0).source
    return tr.Clouds(points=scan.points, colors=scan.colors, viewpoint=scan.viewpoint)


def options_of(cloud, **changes):
    spacing = float(tr.spacing(cloud)[0])
    return replace(tr.options_for(spacing, colored=True), refine="none", **changes)


def test_tiles_give_the_bits_of_the_whole(cloud, monkeypatch):
    monkeypatch.setattr(describe, "_LEAST_TILE", 250)
    options = options_of(cloud)
    whole = describe.describe_clouds(cloud, options)
    calls = []
    monkeypatch.setattr(describe, "tiles_of", lambda *arguments: calls.append(arguments) or tiles_of(*arguments))
    parts = describe.describe_clouds(cloud, options, max_bytes=1)
    assert len(calls) == 1
    assert len(tiles_of(*calls[0])) > 4
    assert same_bits(parts.cloud.normals, whole.cloud.normals)
    assert parts.spacing == whole.spacing
    for one, other in zip(parts.features, whole.features, strict=True):
        assert same_bits((one.values, one.valid), (other.values, other.valid))


def test_every_point_is_some_tiles_own_and_sees_all_within_reach(cloud):
    tiles = tiles_of(cloud, 0.7, 300)
    own = torch.cat([tile.rows[tile.own] for tile in tiles])
    assert own.sort().values.tolist() == list(range(len(cloud.points)))
    for rows, mine in tiles:
        assert 0 < int(mine.sum()) <= 300
        near = (torch.cdist(cloud.points[rows[mine]], cloud.points) < 0.7).any(dim=0).nonzero()[:, 0]
        assert set(near.tolist()) <= set(rows.tolist())


def test_descriptors_that_look_at_the_whole_cloud_have_no_tiles(cloud):
    def reach(*records):
        options = options_of(cloud, descriptors=records, weights=(1.0,) * len(records))
        return reach_of(describe.description_of(options, colored=True))

    normal = options_of(cloud).normal_radius
    assert reach(tr.Fpfh(radius=0.5), tr.Contrast(radius=0.8)) == pytest.approx(1.0 + normal)
    assert reach(tr.Pcfh(radius=0.5, equalization="none")) == pytest.approx(1.0 + normal)
    assert reach(tr.Fpfh(radius=0.5), tr.Pcfh(radius=0.5, equalization="cloud")) is None
