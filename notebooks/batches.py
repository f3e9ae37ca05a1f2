# %% [markdown]
# # Batches of pairs
#
# Scans have different numbers of points, so a batch is packed: all points in one tensor, with offsets. Every stage
# takes such batches, and a pair's result has the same bits alone and in company. Under a minute on two cores.

# %%
from __future__ import annotations

import torch
from matplotlib import pyplot as plt

import torchreg as tr

# %% [markdown]
# ## Packing
#
# Six halls, each scanned from two stations in different light and thinned differently; then two pairs that cannot be
# right: scans of two different halls, and one whose target is empty.

# %%
halls = [tr.datasets.mall(seed, baseline=2.0, angular_step=1.2) for seed in range(6)]
sizes = [6_000, 14_000, 8_000, 20_000, 10_000, 16_000]
chosen = [
    [tr.random_downsample(cloud, size) for cloud in (hall.source, hall.target)]
    for hall, size in zip(halls, sizes, strict=True)
]
truth = torch.stack([hall.T_target_source for hall in halls])
empty = tr.Clouds(torch.zeros(0, 3), colors=torch.zeros(0, 3))
sources = tr.Clouds.pack([*(pair[0] for pair in chosen), chosen[0][0], chosen[0][0]])
targets = tr.Clouds.pack([*(pair[1] for pair in chosen), chosen[1][1], empty])
print(sources, f"offsets {sources.offsets.tolist()}", sep="\n")

# %% [markdown]
# ## Features of all clouds at once
#
# Points of different clouds never see each other.

# %%
near = tr.neighbors(sources, radius=1.5, max_neighbors=60)
described = tr.fpfh(tr.estimate_normals(sources, near), near)
alone = chosen[3][0]
near_alone = tr.neighbors(alone, radius=1.5, max_neighbors=60)
begin, end = sources.offsets[3], sources.offsets[4]
same = torch.equal(described.values[begin:end], tr.fpfh(tr.estimate_normals(alone, near_alone), near_alone).values)
print(f"the fourth cloud has the same bits alone and in the batch: {same}")

# %% [markdown]
# ## Registering all pairs in one call
#
# Every pair has a probability that its pose is right, and a reason where it is refused; it leaves the others alone.

# %%
result = tr.register(sources, targets)
angle = tr.metrics.rre(truth, result.T_target_source[:6]).tolist()
names = [*(f"{degrees:.3f} degrees off" for degrees in angle), "two halls", "empty target"]
for name, success, probability, reason in zip(names, result.success, result.probability, result.reason, strict=True):
    print(f"{name:18} {'registered' if success else 'refused':10} {float(probability):.3f}  {reason}")

# %%
figure, axes = plt.subplots(2, 4, figsize=(12, 6), layout="constrained")
for number, axis in enumerate(axes.flat):
    target = targets[number]
    axis.scatter(*target.points[:, :2].T, c="0.8", s=1, lw=0)
    if len(target.points):
        moved = tr.transform(sources[number], result.T_target_source[number : number + 1])
        points = moved.points + (moved.origin - target.origin).to(moved.points)
        axis.scatter(*points[:, :2].T, c=moved.colors, s=1, lw=0)
    verdict = f"registered, {float(result.probability[number]):.2f}" if result.success[number] else "refused"
    axis.set(title=f"{names[number]}\n{verdict}", aspect="equal", xticks=[], yticks=[])
plt.show()

# %% [markdown]
# ## The same bits alone
#
# Whatever its batch-mates and its place.

# %%
single = tr.register(*chosen[1])
print(f"bit for bit: {torch.equal(single.T_target_source[0], result.T_target_source[1])}")
