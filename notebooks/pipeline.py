# %% [markdown]
# # The paper's pipeline, step by step
#
# Two colored scans of one place, and every step between them and the transform: neighborhoods, normals, FPFH, PCFH,
# fusion, mutual matches, RANSAC. Each step is one function; `tr.register` is these lines and a verdict. Under a minute
# on two cores.

# %%
from __future__ import annotations

import torch
from matplotlib import pyplot as plt

import torchreg as tr

VOXEL = 0.25  # meters; every other length follows from it
LIKE_PAPER = {"normals": 2 * VOXEL, "fpfh": 5 * VOXEL, "pcfh": 2 * VOXEL}  # the paper has 2 m, 5 m, 2 m

# %% [markdown]
# ## Two scans
#
# A simulated mall, scanned from two stations in different light. Each cloud lies in the frame of its own scanner.

# %%
pair = tr.datasets.mall(seed=1, baseline=3.0, angular_step=0.8)
source, target = (tr.voxel_downsample(cloud, VOXEL) for cloud in (pair.source, pair.target))
print(f"{len(source.points):,} and {len(target.points):,} points")


def from_above(axis: plt.Axes, cloud: tr.Clouds, colors: object, title: str, **words: object) -> None:
    """Points seen from above, without what lies over head height."""
    low = cloud.points[:, 2] < cloud.points[:, 2].quantile(0.7)
    shown = colors[low] if isinstance(colors, torch.Tensor) else colors
    axis.scatter(*cloud.points[low, :2].T, c=shown, s=1.5, lw=0, **words)
    axis.set(title=title, aspect="equal", xticks=[], yticks=[])


figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
for axis, cloud, name in zip(axes, (source, target), ("source", "target"), strict=True):
    from_above(axis, cloud, cloud.colors, name)
plt.show()

# %% [markdown]
# ## Neighborhoods and normals
#
# One search serves all stages: `restrict` cuts smaller neighborhoods out of it. Normals are turned to the scanner, so
# that both scans see the same side of a wall.

# %%
near = {name: tr.neighbors(cloud, LIKE_PAPER["fpfh"], 100) for name, cloud in (("source", source), ("target", target))}
source = tr.estimate_normals(source, near["source"].restrict(LIKE_PAPER["normals"], 30))
target = tr.estimate_normals(target, near["target"].restrict(LIKE_PAPER["normals"], 30))
print(f"{near['source'].counts().float().mean():.0f} neighbors on average, itself counted")

figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
from_above(axes[0], source, (source.normals + 1) / 2, "normals as colors")
counts = near["source"].counts()
from_above(axes[1], source, counts, "neighbors within the support of FPFH", cmap="viridis")
plt.show()

# %% [markdown]
# ## FPFH: what the surface looks like around a point
#
# Three angles between oriented points, 11 bins each, weighted over neighbors. A point on a floor and one at an edge:

# %%
shape = {name: tr.fpfh(cloud, near[name]) for name, cloud in (("source", source), ("target", target))}
flat = shape["source"].values.amax(dim=1).argmax()
bent = torch.where(shape["source"].valid, shape["source"].values.std(dim=1), torch.inf).argmin()

figure, axis = plt.subplots(figsize=(10, 2.6), layout="constrained")
for row, name, shift in ((flat, "flat", -0.2), (bent, "bent", 0.2)):
    axis.bar([bin_ + shift for bin_ in range(33)], shape["source"].values[row].tolist(), width=0.4, label=name)
axis.set(xlabel="bin: f1, f2, f3 with 11 each", ylabel="percent (an angle: 200)", title="FPFH of two points")
axis.legend(frameon=False)
plt.show()

# %% [markdown]
# ## PCFH: how colors around a point differ from its own
#
# Hue is a circle, so differences are taken around it; the paper equalizes hue per cloud first.

# %%
color = {
    name: tr.pcfh(cloud, near[name].restrict(LIKE_PAPER["pcfh"]))
    for name, cloud in (("source", source), ("target", target))
}
spread = color["source"].values @ torch.linspace(0, 1, 11) / 200

figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
from_above(axes[0], source, source.colors, "colors")
from_above(axes[1], source, spread, "mean difference of hue in PCFH", cmap="magma")
plt.show()

# %% [markdown]
# ## Fusion and mutual matches
#
# Each block is scaled to unit length; a match stands where each point is the other's nearest. Right matches lie within
# two voxels under the true motion.

# %%
fused = {name: tr.fuse(shape[name], color[name]) for name in shape}
shares = {}
for name, features in {"FPFH": shape, "FPFH + PCFH": fused}.items():
    matches = tr.match_mutual(features["source"], features["target"])
    ratio = float(tr.metrics.inlier_ratio(source, target, matches, pair.T_target_source[None], 2 * VOXEL))
    shares[name] = ratio
    print(f"{name}: {len(matches.source):,} mutual matches, {ratio:.1%} of them right")

moved = tr.transform(source, pair.T_target_source[None])
apart = (moved.points[matches.source] + (moved.origin - target.origin) - target.points[matches.target]).norm(dim=1)
right = apart < 2 * VOXEL
figure, axis = plt.subplots(figsize=(10, 4), layout="constrained")
offset = torch.tensor([1.3 * float(source.points[:, 0].max() - target.points[:, 0].min()), 0.0])
from_above(axis, source, "0.75", "every fortieth match, right ones in green")
below = target.points[:, 2] < target.points[:, 2].quantile(0.7)
axis.scatter(*(target.points[:, :2] + offset)[below].T, c="0.75", s=1.5, lw=0)
for i in range(0, len(right), 40):
    ends = torch.stack([source.points[matches.source[i], :2], target.points[matches.target[i], :2] + offset])
    axis.plot(*ends.T, color="tab:green" if right[i] else "tab:red", lw=0.6, alpha=0.7 if right[i] else 0.25)
plt.show()

# %% [markdown]
# ## RANSAC
#
# Minimal samples in large batches, each with its rigid transform by a closed form; the best is refit to its inliers.

# %%
options = tr.RansacOptions(inlier_threshold=1.5 * VOXEL, hypotheses=200_000)
result = tr.ransac(source, target, matches, options, generator=torch.Generator().manual_seed(0))
truth = pair.T_target_source[None]
errors = [float(error(truth, result.T_target_source)) for error in (tr.metrics.rre, tr.metrics.rte)]
print(f"success {bool(result.success)}; {errors[0]:.2f} degrees and {errors[1]:.3f} m from the truth")

moved = tr.transform(source, result.T_target_source)
moved = moved.points + (moved.origin - target.origin).to(moved.points)
figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
for axis, points, title in ((axes[0], source.points, "before"), (axes[1], moved, "after")):
    axis.scatter(*target.points[:, :2].T, s=0.6, c="tab:blue", lw=0, label="target")
    axis.scatter(*points[:, :2].T, s=0.6, c="tab:orange", lw=0, label="source")
    axis.set(title=title, aspect="equal", xticks=[], yticks=[])
axes[0].legend(frameon=False, markerscale=6)
plt.show()

# %% [markdown]
# ## All of it in one line
#
# `register` derives the lengths from the spacing of the points, lets the poses of several sets of features compete, and
# judges the winner on the clouds themselves.

# %%
whole = tr.register(source, target)
reason = whole.reason[0] or "no doubts"
print(f"success {bool(whole.success)} with probability {float(whole.probability[0]):.3f}: {reason}")
