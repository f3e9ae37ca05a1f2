"""Training of a color model on pairs of scans with known poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.descriptors.learned import LearnedColor
from torchreg.entry import entry
from torchreg.errors import at_least, expect, positive
from torchreg.learning.correspondence_losses import info_nce
from torchreg.learning.prepared import PreparedCloud, PreparedPair, cropped
from torchreg.seeds import generator_of
from torchreg.types import Features


@checked_record
@dataclass(frozen=True, kw_only=True)
class TrainingOptions:
    """Options of training.

    Attributes:
        steps: of the optimizer, one pair each.
        anchors: source points per step, drawn from those with a true partner.
        max_points: of a scan; larger pairs are cropped once, around a place that both scans see.
        rate: step size of Adam.
        temperature: of the contrastive loss.
        color_radius: in voxels, the support of the color block.
        partner_radius: in voxels; points nearer than this under the truth are partners, and those within twice as far
            do not count as wrong.
        seed: of all random draws.

    Example:
        >>> import torchreg as tr
        >>> tr.learning.TrainingOptions(steps=10).temperature
        0.05
    """

    steps: int = 60
    anchors: int = 512
    max_points: int = 5000
    rate: float = 0.03
    temperature: float = 0.05
    color_radius: float = 2.0
    partner_radius: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        at_least(self.steps, "steps", 1)
        at_least(self.anchors, "anchors", 2)
        at_least(self.max_points, "max_points", 2)
        for name in ("rate", "temperature", "color_radius", "partner_radius"):
            positive(getattr(self, name), name)


@entry
def describe_with(model: LearnedColor, side: PreparedCloud, radius: float) -> Features:
    """Features of a prepared cloud; ``radius`` in meters.

    Example:
        >>> import torchreg as tr
        >>> from torchreg.descriptors.learned import LearnedColor
        >>> pair = tr.datasets.mall(seed=1, angular_step=4.0)
        >>> side = tr.learning.prepare_cloud(pair.source, voxel=1.0)
        >>> features = tr.learning.describe_with(LearnedColor(), side, radius=2.0)
        >>> len(features.values) == len(side.cloud.points)
        True
    """
    return model.fused(side.fpfh, model(side.cloud, side.near.restrict(radius).trimmed(), radius))


@entry
def train_color(
    model: LearnedColor,
    pairs: Sequence[PreparedPair],
    options: TrainingOptions | None = None,
    *,
    report: Callable[[int, float], None] | None = None,
) -> list[float]:
    """Train a model in place by contrast: of all points, the true partner should be the most similar.

    Every step draws a pair, draws anchors among the points that have a true partner, and takes InfoNCE both ways
    against all points of the other scan.

    Args:
        model: on the CPU or another device, with the pairs on the same.
        pairs: of any scenes, at least one.
        options: of training; ``None``: the defaults.
        report: called with every step's number and loss.

    Returns:
        The losses of all steps. The same seed gives the same weights, bit for bit, on the CPU.

    Raises:
        ValueError: no pairs, or none whose scans overlap.

    Example:
        >>> import torchreg as tr
        >>> from torchreg.descriptors.learned import LearnedColor
        >>> pair = tr.datasets.mall(seed=1, angular_step=4.0)
        >>> prepared = tr.learning.prepare_pair(
        ...     pair.source, pair.target, pair.T_target_source, 1.0, name=pair.name, scene="mall"
        ... )
        >>> losses = tr.learning.train_color(LearnedColor(), [prepared], tr.learning.TrainingOptions(steps=2))
        >>> len(losses)
        2
    """
    options = options or TrainingOptions()
    expect(len(pairs) > 0, "pairs", "at least one", pairs)
    generator = generator_of(options.seed)
    usable = []
    for pair in [cropped(pair, options.max_points, generator) for pair in pairs]:
        partner, is_close = pair.true_partners(options.partner_radius * pair.voxel)
        if is_close.sum() >= 2:
            usable.append((pair, is_close.nonzero()[:, 0], partner[is_close]))
    expect(len(usable) > 0, "pairs", "pairs whose scans overlap", [pair.name for pair in pairs])
    optimizer = torch.optim.Adam(model.parameters(), lr=options.rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, options.steps)
    losses = []
    for step in range(options.steps):
        pair, rows, partners = usable[int(torch.randint(len(usable), (), generator=generator))]
        drawn = torch.randperm(len(rows), generator=generator)[: options.anchors].to(rows.device)
        loss = _loss(model, pair, rows[drawn], partners[drawn], options)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        losses.append(float(loss.detach()))
        if report is not None:
            report(step, losses[-1])
    return losses


def _loss(model: LearnedColor, pair: PreparedPair, rows: Tensor, partners: Tensor, options: TrainingOptions) -> Tensor:
    """InfoNCE of anchors against all points of the other scan, both ways, as mutual matching compares them."""
    source, target = (
        torch.nn.functional.normalize(describe_with(model, side, options.color_radius * pair.voxel).values, dim=1)
        for side in (pair.source, pair.target)
    )

    def one_way(anchors: Tensor, features: Tensor, partner: Tensor, side: PreparedCloud) -> Tensor:
        points = side.cloud.points
        near_partner = torch.cdist(points[partner], points) < 2 * options.partner_radius * pair.voxel
        return info_nce(anchors, features, partner, ignored=near_partner, temperature=options.temperature)

    forth = one_way(source[rows], target, partners, pair.target)
    back = one_way(target[partners], source, rows, pair.source)
    return (forth + back) / 2
