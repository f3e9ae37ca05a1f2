"""Trains the edges of the color bins and the weight of the color block by the error of the pose itself.

Pairs come from a `DataLoader`, features from modules of `tr.nn`, and gradients pass through soft matches and weighted
Kabsch. With scans of your own, `tr.datasets.ScanPairs("pairs.csv", colors=True)` takes the place of the list.
"""

import torch
from torch.utils.data import DataLoader

import torchreg as tr

VOXEL = 0.8  # meters; coarse, so that this takes seconds

pairs = [tr.datasets.mall(seed, baseline=1.0, angular_step=2.0) for seed in range(2)]
loader = DataLoader(pairs, batch_size=2, collate_fn=tr.datasets.pack_pairs)
fpfh, pcfh, fuse = tr.nn.FPFH(), tr.nn.PCFH(learn_edges=True), tr.nn.Fuse()
match, solve = tr.nn.SoftMatch(temperature=0.05), tr.nn.WeightedKabsch()
optimizer = torch.optim.Adam([*pcfh.parameters(), *fuse.parameters(), *match.parameters()], lr=0.05)


def describe(clouds: tr.Clouds) -> tuple[tr.Clouds, tr.Features]:
    """The clouds of a batch thinned to voxels, and their fused features."""
    clouds = tr.voxel_downsample(clouds, VOXEL)
    near = tr.neighbors(clouds, 5 * VOXEL, 60)
    clouds = tr.estimate_normals(clouds, near.restrict(2 * VOXEL, 30))
    return clouds, fuse(fpfh(clouds, near), pcfh(clouds, near.restrict(2 * VOXEL)))


torch.manual_seed(0)
for epoch in range(5):
    for pair in loader:
        (source, f), (target, g) = describe(pair.source), describe(pair.target)
        T = solve(source, target, match(f, g))  # (B, 4, 4)
        loss = tr.learning.pose_loss(T, pair.T_target_source, translation_weight=0.1).total.mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        print(
            f"epoch {epoch}: loss {loss.item():.3f}, weight of color {(fuse.weights[1] / fuse.weights[0]).item():.3f}"
        )
