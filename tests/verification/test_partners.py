"""No partner within the threshold is overlooked; far away there is none to look for."""

import pytest
import torch

from torchreg.verification.partners import can_be_near, occupancy


@pytest.mark.parametrize("threshold", [1e-3, 0.1, 3.0, 50.0])
@pytest.mark.parametrize("flat", [False, True])
def test_whatever_is_near_can_be_near(threshold, flat):
    g = torch.Generator().manual_seed(0)
    clouds = [size * torch.rand(count, 3, generator=g) - size / 2 for size, count in ((4.0, 300), (9.0, 1), (0.5, 80))]
    if flat:
        clouds = [cloud * torch.tensor([1.0, 0.0, 1.0]) for cloud in clouds]
    limits = torch.tensor([threshold, 2 * threshold, threshold], dtype=torch.float64)
    cells = occupancy(torch.cat(clouds).t().contiguous(), [len(cloud) for cloud in clouds], limits)
    for scan, cloud in enumerate(clouds):
        away = torch.nn.functional.normalize(torch.randn(2000, 3, generator=g), dim=1)
        away *= limits[scan] * 3 * torch.rand(2000, 1, generator=g)
        queries = cloud[torch.randint(len(cloud), (2000,), generator=g)] + away
        least = (queries.double()[:, None] - cloud.double()).square().sum(dim=-1).sqrt().amin(dim=1)
        near = can_be_near(cells, torch.tensor([scan]), queries.t()[:, None])[0]
        assert bool(near[least < limits[scan]].all())
        far = can_be_near(cells, torch.tensor([scan]), (queries + 1000).t()[:, None])[0]
        assert not bool(far.any())


def test_many_far_queries_are_left_out():
    grid = torch.cartesian_prod(torch.arange(40.0), torch.arange(40.0), torch.zeros(1))
    cells = occupancy(grid.t().contiguous(), [len(grid)], torch.tensor([1.0]).double())
    above = grid + torch.tensor([0.0, 0.0, 4.0])
    assert not bool(can_be_near(cells, torch.tensor([0]), above.t()[:, None]).any())


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), 1e30])
def test_queries_beyond_all_numbers_are_far(value):
    cells = occupancy(torch.rand(3, 50), [50], torch.tensor([0.1]).double())
    assert not bool(can_be_near(cells, torch.tensor([0]), torch.full((3, 1, 2), value)).any())
