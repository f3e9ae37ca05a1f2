"""Ten thousand small clouds of every kind of trouble at once: nothing but finite numbers."""

import pytest
import torch
from gradients import changed, finite_gradients

import torchreg as tr

CLOUDS, POINTS = 10_000, 6


def crowd(draw, clouds):
    """Clouds whose points, normals and colors come from few values, so that coincidences are the rule."""

    def pick(*values):
        table = torch.tensor(values, dtype=torch.float32)
        return table[torch.randint(0, len(values), (clouds * POINTS, 3), generator=draw)]

    points = pick(0.0, 1.0, 1.0 + 1e-7, -1e-20, 2.0)
    normals = torch.nn.functional.normalize(pick(0.0, 1.0, -1.0), dim=1)
    colors = pick(0.0, 1.0, 0.5, 0.5 + 1e-7, 1 / 3)
    offsets = torch.arange(0, clouds * POINTS + 1, POINTS)
    return tr.Clouds(points=points, normals=normals, colors=colors, offsets=offsets)


@pytest.mark.parametrize("options", [{}, {"bandwidth": 0.1}])
def test_no_cloud_has_a_value_or_gradient_that_is_not_finite(options):
    cloud = crowd(torch.Generator().manual_seed(0), CLOUDS)
    near = tr.neighbors(cloud, 10.0, POINTS)

    def function(points, normals, colors, weights):
        made = tr.Clouds(points=points, normals=normals, colors=colors, offsets=cloud.offsets)
        shape = tr.fpfh(made, near, binning="soft", neighbor_weights=weights, **options)
        color = tr.pcfh(made, near, binning="soft", neighbor_weights=weights, equalization="none", **options)
        return tr.fuse(shape, color).values

    weights = torch.randint(0, 3, near.index.shape, generator=torch.Generator().manual_seed(1)).float()
    inputs = tuple(value.clone().requires_grad_() for value in (cloud.points, cloud.normals, cloud.colors, weights))
    assert finite_gradients(function, inputs, second=False)


def test_equalization_of_small_clouds_is_finite():
    cloud = crowd(torch.Generator().manual_seed(2), 500)
    near = tr.neighbors(cloud, 10.0, POINTS)
    colors = cloud.colors.clone().requires_grad_()

    def function(colors):
        return tr.pcfh(changed(cloud, colors=colors), near, binning="soft").values

    assert finite_gradients(function, (colors,), second=False)
