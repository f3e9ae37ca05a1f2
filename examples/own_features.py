"""Registers by features of your own: any tensor with a row for every point.

The features propose poses; the clouds decide which is right and how probable it is, as for the library's own.
"""

import torch

import torchreg as tr

hall = tr.datasets.mall(seed=1, angular_step=1.2)
source, target = (tr.voxel_downsample(cloud, 0.3) for cloud in (hall.source, hall.target))


def network(cloud: tr.Clouds) -> torch.Tensor:
    """In place of yours: the color around a point and how far it spreads, beside the shape, (P, 39)."""
    near = tr.neighbors(cloud, radius=1.25, max_neighbors=100)
    shape = tr.fpfh(tr.estimate_normals(cloud, near.restrict(0.5, 30)), near).values / 200
    count = near.valid.sum(dim=1, keepdim=True)
    around = torch.where(near.valid[..., None], cloud.colors[near.index], 0)  # (P, K, 3)
    mean = around.sum(dim=1) / count
    spread = (around.square().sum(dim=1) / count - mean.square()).clamp(min=0).sqrt()
    return torch.cat([shape, mean, spread], dim=1)


result = tr.register_features(source, target, network(source), network(target))
print(result)
print("degrees off:", float(tr.metrics.rre(hall.T_target_source[None], result.T_target_source)))
