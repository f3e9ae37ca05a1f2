# %% [markdown]
# # Gradients through everything
#
# With soft bins, FPFH and PCFH have gradients: to points, normals, colors, the edges of the bins and the weight of
# every neighbor. Matching has them by dual softmax, the pose by weighted Kabsch. So a loss on the pose reaches all that
# the paper fixes by hand. Under a minute on two cores.

# %%
from __future__ import annotations

import torch
from matplotlib import pyplot as plt

import torchreg as tr
from torchreg import learning

torch.manual_seed(0)
VOXEL = 0.5

# %% [markdown]
# ## Soft bins
#
# A vote passes from one bin to the next over a ramp. As the ramp narrows, the hard histogram returns.

# %%
pair = tr.datasets.mall(seed=2, baseline=2.0, angular_step=1.5)
source, target = (tr.voxel_downsample(cloud, VOXEL) for cloud in (pair.source, pair.target))


def oriented(cloud: tr.Clouds) -> tuple[tr.Clouds, tr.Neighborhoods]:
    """With normals, and the neighborhoods that all stages share."""
    near = tr.neighbors(cloud, 5 * VOXEL, 60)
    return tr.estimate_normals(cloud, near.restrict(2 * VOXEL, 30)), near


(source, near_source), (target, near_target) = oriented(source), oriented(target)
hard = tr.fpfh(source, near_source).values
widths = [1.0, 0.3, 0.1, 0.03, 0.01, 0.003]
away = [float((tr.fpfh(source, near_source, binning="soft", bandwidth=w).values - hard).abs().mean()) for w in widths]
figure, axis = plt.subplots(figsize=(5, 3), layout="constrained")
axis.loglog(widths, away, "o-")
axis.set(xlabel="bandwidth", ylabel="mean difference (percent)", title="soft FPFH against hard")
plt.show()

# %% [markdown]
# ## Which points a descriptor depends on
#
# The gradient of one point's FPFH with respect to all points: its neighbors, and theirs.

# %%
points = source.points.clone().requires_grad_()
row = int(near_source.counts().argmax())
moving = tr.Clouds(points=points, normals=source.normals)
values = tr.fpfh(moving, near_source, binning="soft").values
(pull,) = torch.autograd.grad(values[row].square().sum(), points)
strength = pull.norm(dim=1)
print(f"{int((strength > 0).sum())} of {len(points)} points have a say, {int(near_source.counts()[row])} are neighbors")
figure, axis = plt.subplots(figsize=(5, 4), layout="constrained")
axis.scatter(*source.points[:, :2].T, c="0.85", s=3)
felt = strength > 0
shown = axis.scatter(*source.points[felt, :2].T, c=strength[felt].log10(), s=6, cmap="viridis")
figure.colorbar(shown, label="log10 of the gradient")
axis.set(title="what one FPFH hangs on", aspect="equal", xticks=[], yticks=[])
plt.show()

# %% [markdown]
# ## From two clouds to a pose loss
#
# Soft matches, weighted Kabsch, pose loss: how much should color weigh? One number, learned on this pair.

# %%
truth = pair.T_target_source
shapes = [tr.fpfh(cloud, near).values for cloud, near in ((source, near_source), (target, near_target))]
colors = [
    tr.pcfh(cloud, near.restrict(2 * VOXEL), channels=("hue", "saturation", "value"), equalization="none").values
    for cloud, near in ((source, near_source), (target, near_target))
]
anchors = torch.randperm(len(source.points))[:400]
log_weight = torch.zeros((), requires_grad=True)
optimizer = torch.optim.Adam([log_weight], lr=0.1)
history = []


def unit(rows: torch.Tensor) -> torch.Tensor:
    """Rows of unit length."""
    return torch.nn.functional.normalize(rows, dim=1)


for _step in range(30):
    a, b = (torch.cat([unit(s), log_weight.exp() * unit(c)], dim=1) for s, c in zip(shapes, colors, strict=True))
    similarity = unit(a[anchors]) @ unit(b).t() / 0.02
    confidence = similarity.softmax(dim=1) * similarity.softmax(dim=0)  # dual softmax
    weight = confidence.sum(dim=1)
    partner = confidence @ target.points / weight.clamp(min=1e-12)[:, None]
    T = tr.kabsch(source.points[anchors], partner, weight)
    loss = learning.pose_loss(T, truth.float(), translation_weight=0.1).total
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    history.append((float(loss.detach()), float(log_weight.detach().exp())))
print(f"loss {history[0][0]:.3f} -> {history[-1][0]:.3f}, weight of color {history[0][1]:.2f} -> {history[-1][1]:.2f}")

figure, axes = plt.subplots(1, 2, figsize=(8, 3), layout="constrained")
for axis, values_shown, name in zip(axes, zip(*history, strict=True), ("pose loss", "weight of color"), strict=True):
    axis.plot(values_shown)
    axis.set(xlabel="step", title=name)
plt.show()
