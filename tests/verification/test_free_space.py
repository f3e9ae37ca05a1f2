"""What a scanner saw through is free; what lies behind or beside what it saw says nothing."""

import pytest
import torch

from torchreg.verification.free_space import range_image, side_by_side, visibility

SPACING = 0.05


def sphere(radius: float, count: int = 20_000) -> torch.Tensor:
    g = torch.Generator().manual_seed(0)
    return radius * torch.nn.functional.normalize(torch.randn(count, 3, generator=g), dim=1)


def sight(image, points, margin):
    """Of points (N, 3) in one image, (N,)."""
    which = torch.zeros(1, dtype=torch.int64)
    seen = visibility(side_by_side([image]), which, points.t()[:, None], torch.tensor([margin], dtype=torch.float64))
    return type(seen)(*(part[0] for part in seen))


def test_points_before_the_surface_are_in_free_space():
    image = range_image(sphere(2.0), torch.zeros(3), SPACING)
    # the near quantile of ranges is the radius itself, so a farther shell is the one to be told apart
    far = range_image(torch.cat([sphere(1.0, 2000), sphere(3.0)]), torch.zeros(3), SPACING)
    assert image is not None
    assert far is not None
    shell = sphere(1.0, 20_000)[:500]
    hidden = sight(image, sphere(2.5)[:500], 0.1)
    assert not bool(hidden.before.any())
    assert not bool(hidden.on.any())
    assert bool(sight(image, sphere(2.0)[:500], 0.1).on.float().mean() > 0.9)
    assert bool((sight(image, shell * 1.6, 0.1).before | (shell.norm(dim=1) * 1.6 < image.near)).all())


def test_nothing_is_known_where_the_scanner_measured_nothing():
    half = sphere(2.0)
    half = half[half[:, 2] > 0.3]
    image = range_image(half, torch.zeros(3), SPACING)
    assert image is not None
    below = sphere(1.9)
    below = below[below[:, 2] < -0.5]
    seen = sight(image, below, 0.1)
    assert not bool((seen.before | seen.on).any())


def test_a_scanner_moves_with_its_frame():
    points, shift = sphere(2.0), torch.tensor([3.0, -1.0, 2.0])
    one, other = range_image(points, torch.zeros(3), SPACING), range_image(points + shift, shift, SPACING)
    assert one is not None
    assert other is not None
    assert one.near == pytest.approx(other.near, abs=1e-5)
    probe = sphere(1.95)[:300]
    a, b = sight(one, probe, 0.1), sight(other, probe + shift, 0.1)
    assert float((a.on == b.on).float().mean()) > 0.98


@pytest.mark.parametrize("viewpoint", [[float("nan")] * 3, [float("inf"), 0.0, 0.0]])
def test_an_unknown_scanner_has_no_image(viewpoint):
    assert range_image(sphere(2.0), torch.tensor(viewpoint), SPACING) is None


def test_a_scanner_among_its_points_has_no_image():
    g = torch.Generator().manual_seed(0)
    assert range_image(torch.rand(500, 3, generator=g) * 0.2, torch.full((3,), 0.1), SPACING) is None
    assert range_image(torch.zeros(0, 3), torch.zeros(3), SPACING) is None


def test_images_beside_each_other_are_each_their_own():
    points = [sphere(2.0, 5000), sphere(3.0, 9000)]
    viewpoints = [torch.zeros(3), torch.tensor([0.1, 0.2, 0.0])]
    images = [range_image(cloud, place, SPACING) for cloud, place in zip(points, viewpoints, strict=True)]
    probe = sphere(2.5, 400)
    both = visibility(
        side_by_side(images),
        torch.tensor([1, 0, 1]),
        probe.t()[:, None].expand(3, 3, 400),
        torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64),
    )
    for row, (number, margin) in enumerate(((1, 0.1), (0, 0.2), (1, 0.3))):
        alone = sight(images[number], probe, margin)
        assert torch.equal(both.before[row], alone.before)
        assert torch.equal(both.on[row], alone.on)
