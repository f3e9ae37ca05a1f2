# %% [markdown]
# # What the paper leaves open
#
# How many bins should a color histogram have, how much should it weigh, which channels help? And if these are trained
# on some halls, does it hold in others? A small version of `bench/sensitivity.py`, whose tables over real scans stand
# in `docs/benchmarks/sensitivity.md`. Under a minute on two cores.

# %%
from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from matplotlib import pyplot as plt

import torchreg as tr
from torchreg import metrics
from torchreg.descriptors.color import color_values, joint_color_values
from torchreg.descriptors.fuse import rooted
from torchreg.descriptors.learned import LearnedColor
from torchreg.learning.prepared import PreparedCloud, PreparedPair, prepare_pair
from torchreg.learning.training import TrainingOptions, describe_with, train_color

VOXEL = 0.5

# %% [markdown]
# ## Pairs with known poses


# %%
def hall(seed: int) -> PreparedPair:
    """A simulated hall from two stations, with everything that does not change below."""
    made = tr.datasets.mall(seed, baseline=3.0, angular_step=2.0)
    return prepare_pair(made.source, made.target, made.T_target_source, VOXEL, name=made.name, scene=f"hall {seed}")


halls = [hall(seed) for seed in range(3)]


def inlier_ratio(pair: PreparedPair, features: tuple[tr.Features, tr.Features]) -> float:
    """Share of the mutual matches within two voxels of the truth."""
    matches = tr.match_mutual(*features)
    truth = pair.T_target_source[None]
    return float(metrics.inlier_ratio(pair.source.cloud, pair.target.cloud, matches, truth, 2 * VOXEL))


# %% [markdown]
# ## A color block with choices


# %%
@dataclass(frozen=True)
class Variant:
    """The choices; the defaults are the paper's."""

    bins: int = 11
    weight: float = 1.0
    equalization: str = "cloud"
    channels: tuple[str, ...] = ("hue",)
    root: float = 0.0


PAPER_RULE = Variant()


def fused(side: PreparedCloud, values: torch.Tensor, variant: Variant) -> tr.Features:
    """FPFH and the color histograms of one scan, both moved towards their square roots as far as asked."""
    color = tr.pcfh(
        side.cloud, side.near.restrict(2 * VOXEL), bins=variant.bins, channels=variant.channels, values=values
    )
    blocks = [replace(block, values=rooted(block.values, variant.root)) for block in (side.fpfh, color)]
    return tr.fuse(*blocks, weights=(1.0, variant.weight)) if variant.weight > 0 else blocks[0]


def described(pair: PreparedPair, variant: Variant) -> tuple[tr.Features, tr.Features]:
    """The features of both scans."""
    clouds = pair.source.cloud, pair.target.cloud
    if variant.equalization == "joint":
        values = joint_color_values(*clouds)
    else:
        values = tuple(color_values(cloud, variant.equalization) for cloud in clouds)
    return fused(pair.source, values[0], variant), fused(pair.target, values[1], variant)


def mean_ratio(variant: Variant) -> float:
    """Over all halls."""
    return sum(inlier_ratio(pair, described(pair, variant)) for pair in halls) / len(halls)


# %% [markdown]
# ## One choice at a time, around the paper's rule

# %%
axes = {
    "bins": (3, 11, 33),
    "weight": (0.0, 0.5, 1.0, 2.0),
    "equalization": ("none", "cloud", "joint"),
    "channels": (("hue",), ("value",), ("hue", "saturation", "value")),
    "root": (0.0, 0.5, 1.0),
}
figure, panels = plt.subplots(1, len(axes), figsize=(13, 2.8), sharey=True, layout="constrained")
for panel, (axis, values) in zip(panels, axes.items(), strict=True):
    ratios = [mean_ratio(replace(PAPER_RULE, **{axis: value})) for value in values]
    names = [" ".join(word[0] for word in value) if isinstance(value, tuple) else str(value) for value in values]
    panel.plot(names, ratios, "o-")
    panel.set_title(axis)
    print(axis, dict(zip(names, [round(ratio, 3) for ratio in ratios], strict=True)))
panels[0].set_ylim(0, None)
panels[0].set_ylabel("inlier ratio")
plt.show()

# %% [markdown]
# ## Trained on two halls, judged in another
#
# Edges of bins, weights of channels and blocks, a say for every neighbor, and square roots or not: all by gradient.

# %%
seen, unseen = halls[:2], halls[2:]
torch.manual_seed(0)
model = LearnedColor()
losses = train_color(model, seen, TrainingOptions(steps=15, anchors=256, max_points=2000))


@torch.no_grad()
def learned_ratio(pairs: list[PreparedPair]) -> float:
    """Of the model's features."""
    ratios = [
        inlier_ratio(pair, tuple(describe_with(model, side, 2 * VOXEL) for side in (pair.source, pair.target)))
        for pair in pairs
    ]
    return sum(ratios) / len(ratios)


fixed = sum(inlier_ratio(pair, described(pair, PAPER_RULE)) for pair in unseen) / len(unseen)
print(f"a hall not seen: {fixed:.1%} of the matches right by the paper's rule, {learned_ratio(unseen):.1%} learned")

figure, panels = plt.subplots(1, 2, figsize=(9, 3), layout="constrained")
panels[0].plot(losses)
panels[0].set(xlabel="step", ylabel="loss", title="contrastive loss")
for edges, name in zip(model.edges().detach(), model.channels, strict=True):
    panels[1].plot(edges, label=name)
panels[1].set(xlabel="edge", ylabel="difference of colors", title="edges of the bins")
panels[1].legend(frameon=False)
plt.show()
