# %% [markdown]
# # Batches of pairs
#
# Scans have different numbers of points, so a batch is packed: all points in one tensor, with offsets. Every stage
# takes such batches, and a pair's result has the same bits alone and in company. Under a minute on two cores.

# %%
from __future__ import annotations

import time

import torch
from matplotlib import pyplot as plt

import torchreg as tr

# %% [markdown]
# ## Packing
#
# Six pairs of unequal size: halls scanned from two stations each, thinned differently.

# %%
halls = [tr.datasets.mall(seed, baseline=3.0, angular_step=1.2) for seed in range(6)]
sizes = [900, 2500, 1200, 4000, 1800, 3000]
chosen = [
    [tr.random_downsample(cloud, size) for cloud in (hall.source, hall.target)]
    for hall, size in zip(halls, sizes, strict=True)
]
sources, targets = (tr.Clouds.pack(side) for side in zip(*chosen, strict=True))
truth = torch.stack([hall.T_target_source for hall in halls])
print(f"{len(sources)} clouds, offsets {sources.offsets.tolist()}")

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
# A pair that fails, here one whose target is empty, says why and leaves the others alone. So few points in halls that
# look the same after a half turn are refused rather than trusted, right as they are here.

# %%
empty = targets.select([0]).rows(torch.zeros(0, dtype=torch.int64), torch.tensor([0, 0]))
begin_time = time.perf_counter()
result = tr.register(
    tr.Clouds.pack([*sources.unpack(), sources.select([0])]), tr.Clouds.pack([*targets.unpack(), empty])
)
print(f"{time.perf_counter() - begin_time:.1f} s for {len(result.success)} pairs")
angle = tr.metrics.rre(truth, result.T_target_source[:6])
for number, (success, degrees) in enumerate(zip(result.success.tolist(), [*angle.tolist(), float("nan")], strict=True)):
    print(f"pair {number}: success {success!s:5}  {degrees:7.2f} degrees off  {result.reason[number]}")

figure, axis = plt.subplots(figsize=(6, 3), layout="constrained")
axis.bar(range(6), angle.tolist(), color=["tab:blue" if ok else "0.7" for ok in result.success[:6].tolist()])
axis.set(xlabel="pair", ylabel="rotation error (degrees)", title="blue: said to be a success; gray: refused")
plt.show()

# %% [markdown]
# ## The same bits alone
#
# Whatever its batch-mates and its place.

# %%
single = tr.register(*chosen[1])
print(f"bit for bit: {torch.equal(single.T_target_source[0], result.T_target_source[1])}")
