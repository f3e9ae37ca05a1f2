"""Descriptions on disk are the descriptions, and their names tell all that they depend on."""

from dataclasses import replace

import pytest
import torch
from determinism import same_bits
from problems import room_pair

import torchreg as tr
from torchreg.batch.described_file import described_name, read_described, write_described
from torchreg.registration import describe_clouds
from torchreg.registration.describe import description_of
from torchreg.registration.same_clouds import digest_of

OPTIONS = replace(tr.PAPER, normal_radius=0.5, feature_radius=1.2, feature_max_neighbors=30)


@pytest.mark.parametrize("colored", [True, False])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("refine", ["none", "full"])
def test_what_is_written_comes_back(tmp_path, colored, dtype, refine):
    cloud = room_pair(300, dtype=dtype).source
    cloud = replace(cloud, colors=cloud.colors if colored else None, viewpoint=cloud.viewpoint if colored else None)
    described = describe_clouds(cloud, replace(OPTIONS, refine=refine))
    write_described(tmp_path / "one.pt", described)
    again = read_described(tmp_path / "one.pt", described.descriptions[0])
    assert same_bits(again.cloud, described.cloud)
    assert same_bits(again.features, described.features)
    assert again.descriptions == described.descriptions
    assert (again.surfels is None) == (refine == "none")
    assert same_bits(again.surfels, described.surfels)
    assert (again.spacing, again.facts) == (described.spacing, described.facts)


def test_a_cloud_that_cannot_be_registered_keeps_its_reason(tmp_path):
    described = describe_clouds(tr.Clouds(points=torch.ones(9, 3)), OPTIONS)
    write_described(tmp_path / "one.pt", described)
    assert read_described(tmp_path / "one.pt", described.descriptions[0]).facts == described.facts
    assert described.facts[0].defect.kind == "degenerate"


@pytest.mark.parametrize("content", [b"", b"no zip file", None])
def test_what_is_no_description_is_none(tmp_path, content):
    file = tmp_path / "one.pt"
    if content is not None:
        file.write_bytes(content)
    assert read_described(file, description_of(OPTIONS, colored=True)) is None
    write_described(file, describe_clouds(room_pair(200).source, OPTIONS))
    file.write_bytes(file.read_bytes()[:-100])
    assert read_described(file, description_of(OPTIONS, colored=True)) is None
    write_described(file, describe_clouds(room_pair(200).source, OPTIONS))
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 0x40  # a byte that changed on the disk
    file.write_bytes(bytes(content))
    assert read_described(file, description_of(OPTIONS, colored=True)) is None
    torch.save({"points": torch.rand(3, 3)}, file)
    assert read_described(file, description_of(OPTIONS, colored=True)) is None


def test_a_description_under_the_name_of_another_is_none(tmp_path):
    """Files that were swapped or copied on the disk are whole, but of another cloud."""
    described = describe_clouds(room_pair(200).source, OPTIONS)
    first, other = tmp_path / "first.pt", tmp_path / "other.pt"
    write_described(first, described)
    first.rename(other)
    assert read_described(other, described.descriptions[0]) is None
    other.rename(first)
    assert same_bits(read_described(first, described.descriptions[0]).cloud, described.cloud)


def test_names_differ_where_anything_does():
    cloud = room_pair(100).source
    clouds = [
        cloud,
        replace(cloud, colors=None),
        replace(cloud, origin=cloud.origin + 1),
        replace(cloud, viewpoint=None),
        replace(cloud, viewpoint_assumed=torch.tensor([True])),
    ]
    clouds.append(replace(cloud, points=cloud.points.double(), colors=cloud.colors.double()))
    digests = [digest_of(one) for one in clouds]
    assert len(set(digests)) == len(clouds)
    assert digest_of(replace(cloud, points=cloud.points.clone())) == digests[0]
    options = [OPTIONS, *(replace(OPTIONS, **{name: 0.7}) for name in ("voxel_size", "normal_radius", "color_radius"))]
    options = [description_of(option, colored=colored) for option in options for colored in (True, False)]
    options.remove(options[-1])  # without colors their radius is in no description
    refined = [replace(OPTIONS, refine=each) for each in ("coarse", "full")] + [
        replace(OPTIONS, refine="full", refine_points=500)
    ]
    options += [description_of(option, colored=True) for option in refined]
    devices = ("cpu", "cuda")
    names = {described_name(digest, option, device) for digest in digests for option in options for device in devices}
    assert len(names) == len(digests) * len(options) * len(devices)
