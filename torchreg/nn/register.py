"""Registration of two clouds as one module, every step of which passes gradients on."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from torchreg.arguments import checked
from torchreg.descriptors.descriptor import Descriptor
from torchreg.descriptors.fpfh import Fpfh
from torchreg.descriptors.pcfh import Pcfh
from torchreg.errors import expect, expect_shape
from torchreg.nn.descriptors import FPFH, PCFH
from torchreg.nn.equalize import Equalize
from torchreg.nn.matching import Fuse, SoftMatch, WeightedKabsch
from torchreg.registration.describe import downsample, oriented, support_of
from torchreg.registration.described import Description
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.plan import options_of_pairs
from torchreg.registration.spacing import derive_options
from torchreg.types import Clouds, Features, SoftCorrespondences
from torchreg.types.precision import full_precision, widened


class SoftRegistration(NamedTuple):
    """Poses of B pairs with all that led to them, for losses on any part of it.

    Attributes:
        T_target_source: (B, 4, 4) float64, meters, origins included.
        matches: of the points below.
        source: the clouds that were described: downsampled where options have voxels, in Z order, with normals.
        target: likewise.
        source_features: of its points.
        target_features: likewise.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=4.0)
        >>> result = tr.nn.Register(tr.RegistrationOptions(voxel_size=1.5))(pair.source, pair.target)
        >>> result.T_target_source.shape, result.source_features.blocks[0]
        (torch.Size([1, 4, 4]), ('fpfh', 33))
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
        descriptors: modules in the order of their blocks, ``FPFH``, ``PCFH`` or any of yours: called with the clouds,
            which have normals, and the ``Neighborhoods`` of their points, a module returns ``Features`` or a tensor
            (P, D). ``None``: soft ones as the options' records say, FPFH and PCFH without options. The support of a
            module is that of the record of its kind in the options, module by module, of any of yours that of an
            ``Fpfh``; where there is none, of the first record.
        fuse: ``None``: weights of 1 to begin with, or the options' ``weights``, and their ``root``.
        match: ``None``: ``SoftMatch()``, dual softmax.
        solve: ``None``: ``WeightedKabsch(rounds=5)``. A scale of its own holds; else the inlier threshold.

    Raises:
        ValueError: no descriptors, or options with another one than ``Fpfh`` and ``Pcfh`` and no modules given.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=3.0)
        >>> result = Register(tr.RegistrationOptions(voxel_size=1.0))(pair.source, pair.target)
        >>> result.T_target_source.shape, result.T_target_source.requires_grad
        (torch.Size([1, 4, 4]), True)
    """

    @checked
    def __init__(
        self,
        options: RegistrationOptions | None = None,
        *,
        descriptors: Sequence[nn.Module] | None = None,
        fuse: Fuse | None = None,
        match: SoftMatch | None = None,
        solve: WeightedKabsch | None = None,
    ) -> None:
        super().__init__()
        self.options = options
        every = options is None or options.keypoints is None
        expect(every, "options.keypoints", "None, since all points are matched softly", options)
        self.descriptors = nn.ModuleList(_descriptors_of(options) if descriptors is None else descriptors)
        count = len(self.descriptors)
        expect(count > 0, "descriptors", "at least one", descriptors)
        weights = options.weights if options is not None and descriptors is None else (1.0,) * count
        root = 0.0 if options is None else options.root
        joint = options is not None and any(record.is_pairwise for record in options.descriptors)
        self.equalize = Equalize() if joint else None
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
        if torch.compiler.is_compiling():
            _expect_one_graph(self.options)
        given = derive_options(source.detach(), target.detach()) if self.options is None else self.options
        per_pair = options_of_pairs(given, len(source))
        voxels = [option.voxel_size for option in per_pair]
        if any(voxel is not None for voxel in voxels):  # means over voxels pass no gradients on
            source, target = source.detach(), target.detach()
        source, target = downsample(source, voxels), downsample(target, voxels)
        joint = (None, None) if self.equalize is None else self.equalize.joint(source, target)
        source, source_features = self._described(source, per_pair, joint[0])
        target, target_features = self._described(target, per_pair, joint[1])
        matches = self.match(source_features, target_features)
        scale = None
        if self.solve.rounds > 0 and self.solve.scale is None:
            scale = torch.tensor([option.inlier_threshold for option in per_pair], dtype=torch.float32)
        T = self.solve(source, target, matches, scale=scale)
        return SoftRegistration(T, matches, source, target, source_features, target_features)

    def _described(
        self, cloud: Clouds, options: Sequence[RegistrationOptions], values: Tensor | None
    ) -> tuple[Clouds, Features]:
        descriptions = [
            Description(
                voxel_size=option.voxel_size,
                normal_radius=option.normal_radius,
                normal_max_neighbors=option.normal_max_neighbors,
                descriptors=_records_of(self.descriptors, option),
            )
            for option in options
        ]
        cloud, near = oriented(cloud, descriptions)
        blocks = []
        for number, module in enumerate(self.descriptors):
            records = [description.descriptors[number] for description in descriptions]
            support = support_of(cloud, near, records)
            colors = {"values": values} if isinstance(module, PCFH) and records[0].is_pairwise else {}
            blocks.append(_block_of(module(cloud, support, **colors), cloud, f"descriptors[{number}]"))
        return cloud, self.fuse(*blocks)


def _block_of(answer: Features | Tensor, cloud: Clouds, name: str) -> Features:
    """What a module returned, as features; a row of zeros in a tensor describes nothing."""
    if isinstance(answer, Features):
        return answer
    expect_shape(answer, name, (cloud.points.shape[0], "D"), "floating", cloud.device)
    values = widened(answer)
    return Features(values, cloud.offsets, ((name, values.shape[1]),), (values.detach() != 0).any(dim=1))


def _expect_one_graph(options: RegistrationOptions | None) -> None:
    """Refuse what no graph of fixed operations does: reading lengths off the points, and thinning by voxels."""
    fixed = isinstance(options, RegistrationOptions) and options.voxel_size is None
    expect(fixed, "options", "lengths without voxels, where a graph is captured", options)


def _records_of(modules: Iterable[nn.Module], options: RegistrationOptions) -> tuple[Descriptor, ...]:
    """The records whose supports the modules have: the next of their kind, else the last of it, else the first."""
    left = list(options.descriptors)
    records: list[Descriptor] = []
    for module in modules:
        kind = Pcfh if isinstance(module, PCFH) else Fpfh
        alike = [record for record in left if isinstance(record, kind)]
        if alike:
            left.remove(alike[0])
        before = [record for record in records if isinstance(record, kind)]
        records.append(alike[0] if alike else before[-1] if before else options.descriptors[0])
    return tuple(records)


def _descriptors_of(options: RegistrationOptions | None) -> list[nn.Module]:
    if options is None:
        return [FPFH(), PCFH()]
    modules: list[nn.Module] = []
    for record in options.descriptors:
        if isinstance(record, Pcfh):
            color = PCFH(
                bins=record.bins,
                channels=record.channels,
                equalization="cloud" if record.is_pairwise else record.equalization,
                saturation_weighting=record.saturation_weighting,
            )
            modules.append(color)
        else:
            expect(isinstance(record, Fpfh), "options.descriptors", "Fpfh and Pcfh", record)
            modules.append(FPFH(mode=record.mode) if isinstance(record, Fpfh) else FPFH())
    return modules
