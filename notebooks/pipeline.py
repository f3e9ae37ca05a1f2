# %% [markdown]
# # From two scans to a pose, step by step
#
# Two colored scans of one place, and every step between them and the transform: neighborhoods, normals, FPFH, color,
# fusion, mutual matches, RANSAC. Each step is one function; `tr.register` is these lines, a competition of poses and a
# verdict. Under a minute on two cores.

# %%
from __future__ import annotations

import torch
from matplotlib import pyplot as plt

import torchreg as tr

VOXEL = 0.25  # meters; every other length follows from it
SUPPORT = 5 * VOXEL  # of features; the paper has 5 m

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
near = {name: tr.neighbors(cloud, SUPPORT, 100) for name, cloud in (("source", source), ("target", target))}
source = tr.estimate_normals(source, near["source"].restrict(2 * VOXEL, 30))
target = tr.estimate_normals(target, near["target"].restrict(2 * VOXEL, 30))
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
# ## Color: what a change of light leaves as it is
#
# The two scans were taken in different light, so their colors differ. Contrast compares every channel with its mean
# around the point; PCFH counts how hue, saturation and value around a point differ from its own.

# %%
clouds = {"source": source, "target": target}
contrast = {name: tr.contrast(cloud, near[name], SUPPORT) for name, cloud in clouds.items()}
hsv = {"channels": ("hue", "saturation", "value"), "equalization": "none"}
channels = {name: tr.pcfh(cloud, near[name], **hsv) for name, cloud in clouds.items()}
paper = {name: tr.pcfh(cloud, near[name].restrict(2 * VOXEL)) for name, cloud in clouds.items()}

figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
from_above(axes[0], source, source.colors, "colors")
from_above(axes[1], source, contrast["source"].values.norm(dim=1), "strength of the contrast", cmap="magma")
plt.show()

# %% [markdown]
# ## Fusion and mutual matches
#
# Each block is scaled to unit length, and weighted; a match stands where each point is the other's nearest. Right
# matches lie within two voxels under the true motion.
#
# Color can double the share of right matches, but not in every form: the paper's block, equalized hue alone, loses
# against FPFH here. Walls and floors are nearly gray, so their hue is noise, and equalizing spreads that noise over all
# bins. What `tr.register` takes by default is the last row, with these weights.

# %%
fused = {
    "FPFH alone": shape,
    "the paper: FPFH, equalized hue": {name: tr.fuse(shape[name], paper[name]) for name in shape},
    "the default: FPFH, contrast, PCFH": {
        name: tr.fuse(shape[name], contrast[name], channels[name], weights=(1.0, 0.8, 0.5)) for name in shape
    },
}
shares = {}
for name, features in fused.items():
    matches = tr.match_mutual(features["source"], features["target"])
    ratio = float(tr.metrics.inlier_ratio(source, target, matches, pair.T_target_source[None], 2 * VOXEL))
    shares[name] = ratio
    print(f"{name:34} {len(matches.source):6,} mutual matches, {ratio:6.1%} of them right")

moved = tr.transform(source, pair.T_target_source[None])
apart = (moved.points[matches.source] + (moved.origin - target.origin) - target.points[matches.target]).norm(dim=1)
right = apart < 2 * VOXEL
figure, axis = plt.subplots(figsize=(10, 4), layout="constrained")
offset = torch.tensor([1.3 * float(source.points[:, 0].max() - target.points[:, 0].min()), 0.0])
from_above(axis, source, "0.75", "every twentieth match of the default's features, right ones in green")
below = target.points[:, 2] < target.points[:, 2].quantile(0.7)
axis.scatter(*(target.points[:, :2] + offset)[below].T, c="0.75", s=1.5, lw=0)
for i in range(0, len(right), 20):
    ends = torch.stack([source.points[matches.source[i], :2], target.points[matches.target[i], :2] + offset])
    axis.plot(*ends.T, color="tab:green" if right[i] else "tab:red", lw=0.7, alpha=0.9 if right[i] else 0.15)
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
# `register` derives the lengths from the spacing of the points, lets poses compete on the clouds themselves, refines
# the winner on all points that it was given, and says how likely it is right and what was weighed.

# %%
whole = tr.register(pair.source, pair.target)
errors = [float(error(truth, whole.T_target_source)) for error in (tr.metrics.rre, tr.metrics.rte)]
print(whole.explain())
print(f"\n{errors[0]:.3f} degrees and {1000 * errors[1]:.1f} mm from the truth")
