"""Spin images: plain loops say the same, gradients are true, and signs of normals mirror."""

import math
from importlib import import_module

import pytest
import torch
from closeness import close
from determinism import assert_nothing_shows, same_bits
from gradients import FEW, TROUBLE, assert_derivatives, finite_gradients, leaves, small
from problems import oriented_room, sphere_cloud
from refusals import refuses

import torchreg as tr
from torchreg.geometry.numerics.chunks import CACHE_ELEMENTS

OPTIONS = [
    {},
    {"width": 3, "structure": "radial"},
    {"content": "angles", "support_cosine": 0.6},
    {"structure": "radial", "content": "angles"},
]
every_option = pytest.mark.parametrize("options", OPTIONS)


def image_of(cloud, near, row, width=8, support_cosine=0.0, structure="rectangular", content="counts"):
    """One image by a loop over neighbors."""
    sums, angles = torch.zeros(2, width + 1, 2 * width + 1, dtype=torch.float64)
    own, normal = cloud.points[row], cloud.normals[row]
    reach = near.radius if structure == "radial" else near.radius / math.sqrt(2)
    for other in near.index[row][near.valid[row]].tolist():
        line = cloud.points[other] - own
        distance, cosine = float(line.norm()), float(normal @ cloud.normals[other])
        if distance == 0 or abs(cosine) < support_cosine:
            continue
        lean = min(1.0, max(-1.0, float(normal @ line) / distance))
        alpha, beta = distance * math.sqrt(1 - lean * lean) / reach, distance * lean / reach
        if structure == "radial":
            alpha, beta = distance / reach, math.asin(lean) / (math.pi / 2)
        elif alpha >= 1 or abs(beta) >= 1:
            continue
        i, j = min(width - 1, int(alpha * width)), min(2 * width - 1, int((beta + 1) * width))
        a, b = alpha * width - i, (beta + 1) * width - j
        for di, dj, share in ((0, 0, (1 - a) * (1 - b)), (1, 0, a * (1 - b)), (0, 1, (1 - a) * b), (1, 1, a * b)):
            sums[i + di, j + dj] += share
            angles[i + di, j + dj] += share * math.acos(min(1.0, abs(cosine)))
    if content == "angles":
        return torch.where(sums > 0, angles / sums.clamp(min=1e-300), 0).flatten()
    return (sums / sums.sum().clamp(min=1e-300)).flatten()


@every_option
def test_values_are_those_of_plain_loops(options):
    cloud = sphere_cloud(100, seed=2)
    near = tr.neighbors(cloud, 0.8, 40)
    found = tr.spin_images(cloud, near, **options)
    width = options.get("width", 8)
    assert found.blocks == (("spin_images", (width + 1) * (2 * width + 1)),)
    for row in range(0, 100, 9):
        assert close(found.values[row], image_of(cloud, near, row, **options), atol=1e-7)


@every_option
def test_derivatives_are_true(options):
    cloud = small()
    near = tr.neighbors(cloud, 3.0, FEW)
    points, normals, _, _ = leaves(cloud, near)
    options = {**options, "width": 2}  # few numbers to compare

    def function(points, normals):
        return tr.spin_images(tr.Clouds(points=points, normals=normals), near, **options).values

    assert_derivatives(function, (points, normals))


@every_option
@pytest.mark.parametrize("trouble", TROUBLE)
def test_derivatives_are_finite_in_trouble(trouble, options):
    cloud = TROUBLE[trouble]()
    near = tr.neighbors(cloud, 9.0, FEW)
    points, normals, _, _ = leaves(cloud, near)

    def function(points, normals):
        return tr.spin_images(tr.Clouds(points=points, normals=normals), near, **options).values

    assert finite_gradients(function, (points, normals))


def test_neither_threads_nor_pieces_change_a_bit_of_gradients():
    cloud, near = oriented_room(1500)

    def run():
        points = cloud.points.clone().requires_grad_()
        values = tr.spin_images(tr.Clouds(points=points, normals=cloud.normals), near).values
        return values.detach(), *torch.autograd.grad(values.square().sum(), points)

    assert_nothing_shows(run)


@every_option
def test_the_sign_of_normals_mirrors_the_image(options):
    cloud = sphere_cloud(150)
    record, near = tr.SpinImages(radius=0.7, **options), tr.neighbors(cloud, 0.7, 40)
    turned = tr.Clouds(points=cloud.points, normals=-cloud.normals)
    one, other = (record.describe(each, near).values for each in (cloud, turned))
    assert not close(one, other, atol=1e-2)
    assert close(record.unsigned(one), record.unsigned(other), atol=1e-9)


def test_a_radius_per_point_is_the_radius_of_that_point():
    cloud = sphere_cloud(100)
    near = tr.neighbors(cloud, 0.7, 40)
    each = tr.Neighborhoods(near.index, near.valid, near.sq_distance, torch.full((100,), 0.7, dtype=torch.float64))
    assert close(tr.spin_images(cloud, each).values, tr.spin_images(cloud, near).values, atol=1e-12)


def test_a_point_alone_is_not_valid():
    points = torch.tensor([[0.0, 0, 0], [0.1, 0, 0], [9.0, 9, 9]])
    cloud = tr.Clouds(points=points, normals=torch.tensor([0.0, 0, 1]).expand(3, 3))
    features = tr.spin_images(cloud, tr.neighbors(cloud, 1.0, 3))
    assert features.valid.tolist() == [True, True, False]
    assert torch.isfinite(features.values).all()


def test_what_does_not_fit_is_refused():
    cloud = sphere_cloud(50)
    near = tr.neighbors(cloud, 0.7, 20)
    with refuses("cloud", "normals", "none"):
        tr.spin_images(tr.Clouds(points=cloud.points), near)
    with refuses("near", "radius", "None"):
        tr.spin_images(cloud, tr.Neighborhoods(near.index, near.valid, near.sq_distance))
    with refuses("support_cosine", "[0, 1]", "1.5"):
        tr.spin_images(cloud, near, support_cosine=1.5)
    with refuses("structure", "radial", "round"):
        tr.SpinImages(radius=1, structure="round")
    with refuses("width", "1", "0"):
        tr.SpinImages(radius=1, width=0)


def test_pieces_stay_small_whatever_the_size_of_an_image(monkeypatch):
    cloud, near = oriented_room(200)
    sizes, expected = [], tr.spin_images(cloud, near, width=64).values

    spin = import_module("torchreg.descriptors.spin_images")
    plain = spin.grid_votes
    monkeypatch.setattr(spin, "grid_votes", lambda *given: sizes.append(plain(*given)) or sizes[-1])
    assert same_bits(tr.spin_images(cloud, near, width=64).values, expected)
    assert sum(len(each) for each in sizes) == len(cloud.points)
    assert max(each.numel() for each in sizes) <= CACHE_ELEMENTS
