"""The whole way from two clouds to their pose as one module, every step of which passes gradients on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor, nn

from torchreg.errors import expect
from torchreg.nn.descriptors import FPFH, PCFH
from torchreg.nn.equalize import Equalize
from torchreg.nn.matching import Fuse, SoftMatch, WeightedKabsch
from torchreg.nn.precision import full_precision
from torchreg.registration.describe import downsample, oriented, per_point
from torchreg.registration.pair_options import options_of_pairs
from torchreg.types import Clouds, Features, RegistrationOptions, SoftCorrespondences


class SoftRegistration(NamedTuple):
    """Poses of B pairs with all that led to them, for losses on any part of it.

    Attributes:
        T_target_source: (B, 4, 4) float64, meters, origins included.
        matches: of the points below.
        source: the clouds as they were described: thinned if asked for, in Z order, with normals.
        target: likewise.
        source_features: of its points.
        target_features: likewise.
    """

    T_target_source: Tensor
    matches: SoftCorrespondences
    source: Clouds
    target: Clouds
    source_features: Features
    target_features: Features


class Register(nn.Module):
    """Normals, descriptors, fusion, soft matches and a robust weighted Kabsch, with learnable weights.

    What is learned serves the rest of the package too: ``match_mutual`` and ``ransac`` take the clouds and features of
    the result.

    Args:
        options: lengths and numbers of neighbors in meters (voxels, supports, inlier threshold); ``None`` derives them
            from every pair (``derive_options``). Solver, effort and what concerns matches and hypotheses are not read.
        descriptors: ``FPFH`` and ``PCFH`` modules in the order of their blocks; ``None``: soft ones, FPFH and, unless
            options leave color out, PCFH as options say.
        fuse: ``None``: weights of 1 to begin with, or the options' ``color_weights``, and their ``root``.
        match: ``None``: ``SoftMatch()``, dual softmax.
        solve: ``None``: ``WeightedKabsch(rounds=5)``. A scale of its own holds; else the inlier threshold.

    Raises:
        ValueError: no descriptors, or options with another color block than ``"pcfh"`` and none given.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=3.0)
        >>> found = Register(tr.RegistrationOptions(voxel_size=1.0))(pair.source, pair.target)
        >>> found.T_target_source.shape, found.T_target_source.requires_grad
        (torch.Size([1, 4, 4]), True)
    """

    def __init__(
        self,
        options: RegistrationOptions | None = None,
        *,
        descriptors: Sequence[FPFH | PCFH] | None = None,
        fuse: Fuse | None = None,
        match: SoftMatch | None = None,
        solve: WeightedKabsch | None = None,
    ) -> None:
        super().__init__()
        self.options = options
        self.descriptors = nn.ModuleList(_descriptors_of(options) if descriptors is None else descriptors)
        count = len(self.descriptors)
        expect(count > 0, "descriptors", "at least one", descriptors)
        weights = (1.0, *options.color_weights) if options is not None and descriptors is None else (1.0,) * count
        root = 0.0 if options is None else options.root
        self.equalize = Equalize() if options is not None and options.equalization == "joint" else None
        self.fuse = Fuse(weights, root=root) if fuse is None else fuse
        self.match = SoftMatch() if match is None else match
        self.solve = WeightedKabsch(rounds=5) if solve is None else solve

    @full_precision
    def forward(self, source: Clouds, target: Clouds) -> SoftRegistration:
        """Poses of B pairs of clouds.

        Args:
            source: B clouds, finite, with colors where a descriptor reads them.
            target: B clouds.

        Returns:
            SoftRegistration. Gradients flow to all weights, and to points and colors unless voxels thin them. Memory
            grows with the product of the points of a pair: some thousands each.

        Raises:
            ValueError: different numbers of clouds, or no colors where they are read.
        """
        expect(len(source) == len(target), "target", f"{len(source)} clouds, as the source has", len(target))
        expect(len(source) > 0, "source", "at least one cloud", len(source))
        per_pair = self._options_of(source, target)
        if any(option.voxel_size is not None for option in per_pair):  # means over voxels pass no gradients on
            source, target = source.detach(), target.detach()
        source, target = downsample(source, per_pair), downsample(target, per_pair)
        joint = (None, None) if self.equalize is None else self.equalize.joint(source, target)
        source, source_features = self._described(source, per_pair, joint[0])
        target, target_features = self._described(target, per_pair, joint[1])
        matches = self.match(source_features, target_features)
        scale = None
        if self.solve.rounds > 0 and self.solve.scale is None:
            scale = torch.tensor([option.ransac.inlier_threshold for option in per_pair])
        T = self.solve(source, target, matches, scale=scale)
        return SoftRegistration(T, matches, source, target, source_features, target_features)

    def _options_of(self, source: Clouds, target: Clouds) -> tuple[RegistrationOptions, ...]:
        """Lengths of every pair; color exactly where a descriptor reads it, so that supports are wide enough."""
        per_pair = options_of_pairs(source.detach(), target.detach(), self.options, "plain", None)
        colored = any(isinstance(module, PCFH) for module in self.descriptors)
        names, weights = (("pcfh",), (1.0,)) if colored else ((), ())
        return tuple(replace(option, color=names, color_weights=weights) for option in per_pair)

    def _described(
        self, cloud: Clouds, options: Sequence[RegistrationOptions], values: Tensor | None
    ) -> tuple[Clouds, Features]:
        cloud, near = oriented(cloud, options)
        support = near.restrict(
            per_point(cloud, options, lambda option: option.feature_radius), options[0].feature_max_neighbors
        )
        color_support = near.restrict(per_point(cloud, options, lambda option: option.color_radius))
        blocks = [
            module(cloud, color_support, values=values) if isinstance(module, PCFH) else module(cloud, support)
            for module in self.descriptors
        ]
        return cloud, self.fuse(*blocks)


def _descriptors_of(options: RegistrationOptions | None) -> list[FPFH | PCFH]:
    if options is None:
        return [FPFH(), PCFH()]
    expect(set(options.color) <= {"pcfh"}, "options.color", "('pcfh',) or ()", options.color)
    found: list[FPFH | PCFH] = [FPFH()]
    for _ in options.color:
        color = PCFH(
            bins=options.color_bins,
            channels=options.color_channels,
            equalization="cloud" if options.equalization == "joint" else options.equalization,
            saturation_weighting=options.saturation_weighting,
        )
        found.append(color)
    return found
