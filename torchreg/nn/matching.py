"""From features to poses, each step with what it learns: fusion, soft matching, weighted Kabsch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor, nn

from torchreg.arguments import checked
from torchreg.descriptors import DESCRIPTORS
from torchreg.descriptors.fuse import fuse, rooted
from torchreg.errors import at_least, expect, expect_shape, finite, fraction, one_of, positive
from torchreg.geometry.numerics.derivatives import transformed
from torchreg.geometry.se3 import apply_rotation, rigid
from torchreg.geometry.soft_kabsch import robust_kabsch, soft_kabsch
from torchreg.matching import soft_match
from torchreg.matching.soft import METHODS
from torchreg.types import Clouds, Features, SoftCorrespondences
from torchreg.types.packing import spans
from torchreg.types.precision import full_precision, widened

_HISTOGRAMS = {record.name for record in DESCRIPTORS.values() if record.is_histogram}


class Fuse(nn.Module):
    """``torchreg.fuse`` whose block weights are learned, as logarithms, so that they stay above 0.

    Args:
        weights: initial ones, one per descriptor, above 0. The paper weighs FPFH and PCFH alike.
        root: in [0, 1], how far the entries of FPFH and PCFH are first moved towards their square roots, as in
            ``RegistrationOptions``.

    Attributes:
        log_weights: (blocks,) learnable.

    Raises:
        ValueError: no weights, one that is not above 0, or a root out of its range.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(torch.rand(50, 3), colors=torch.rand(50, 3))
        >>> near = tr.neighbors(cloud, radius=0.5, max_neighbors=20)
        >>> cloud = tr.estimate_normals(cloud, near)
        >>> tr.nn.Fuse((1.0, 0.5))(tr.nn.FPFH()(cloud, near), tr.nn.PCFH()(cloud, near)).values.requires_grad
        True
    """

    @checked
    def __init__(self, weights: Sequence[float] = (1.0, 1.0), *, root: float = 0.0) -> None:
        super().__init__()
        self.root = fraction(root, "root", zero=True)
        expect(len(weights) > 0, "weights", "at least one", weights)
        self.log_weights = nn.Parameter(_of_float32([positive(weight, "weights") for weight in weights]).log())

    @property
    def weights(self) -> Tensor:
        """(blocks,) above 0, the factors of rows of unit length."""
        return widened(self.log_weights).exp()

    @full_precision
    def forward(self, *features: Features) -> Features:
        """Blocks of unit length, weighted and concatenated, as by ``torchreg.fuse``.

        Gradients flow to the features and to ``log_weights``.

        Args:
            features: descriptors of the same points, one per weight.

        Raises:
            ValueError: another number of descriptors, or descriptors of different points.
        """
        count = len(self.log_weights)
        expect(len(features) == count, "features", f"{count} descriptors, one per weight", len(features))
        plain = fuse(*map(self._rooted, features))
        weights = self.weights.to(plain.values)
        scale = torch.cat([weights[i].expand(item.values.shape[1]) for i, item in enumerate(features)])  # (D,)
        return replace(plain, values=plain.values * scale)

    def _rooted(self, item: Features) -> Features:
        if self.root == 0 or any(name not in _HISTOGRAMS for name, _ in item.blocks):
            return item
        return replace(item, values=rooted(item.values, self.root))

    def extra_repr(self) -> str:
        """What ``print`` shows."""
        return f"blocks={len(self.log_weights)}, root={self.root}"


class SoftMatch(nn.Module):
    """``torchreg.soft_match`` with a learned temperature, as its logarithm, and a learned dustbin.

    The defaults fit fused FPFH and PCFH: on simulated rooms true partners lie 0.02 to 0.15 apart in
    squares, the nearest features of all 0.01 to 0.07. Other features want other numbers, or to be scaled to that, as
    ``Fuse`` does: where they lie farther apart than the dustbin by many temperatures, every confidence is 0 and so is
    every gradient. The sum of ``confidence`` shows it: about as many as points have a partner, not 0.

    Args:
        method: ``"dual_softmax"`` or ``"sinkhorn"``.
        temperature: the initial one, of squared distances of features, above 0.
        dustbin: the initial one, minus the squared distance from which on a point more likely has no partner;
            ``None`` leaves it out, which Sinkhorn does not allow.
        iterations: of Sinkhorn.

    Attributes:
        log_temperature: () learnable.
        dustbin: () learnable, or ``None``.

    Raises:
        ValueError: an unknown method, a number out of its range, or Sinkhorn without a dustbin.

    Example:
        >>> import torch, torchreg as tr
        >>> rows = tr.Features(torch.eye(3), torch.tensor([0, 3]), (("any", 3),), torch.tensor([True, True, True]))
        >>> tr.nn.SoftMatch()(rows, rows).confidence[0].shape
        torch.Size([3, 3])
    """

    @checked
    def __init__(
        self,
        *,
        method: str = "dual_softmax",
        temperature: float = 0.01,
        dustbin: float | None = -0.1,
        iterations: int = 50,
    ) -> None:
        super().__init__()
        self.method = one_of(method, "method", METHODS)
        self.iterations = at_least(iterations, "iterations", 1)
        expect(method == "dual_softmax" or dustbin is not None, "dustbin", "a number with Sinkhorn", dustbin)
        self.log_temperature = nn.Parameter(_of_float32(math.log(positive(temperature, "temperature"))))
        self.dustbin = None if dustbin is None else nn.Parameter(_of_float32(finite(dustbin, "dustbin")))

    @property
    def temperature(self) -> Tensor:
        """() above 0."""
        return widened(self.log_temperature).exp()

    @full_precision
    def forward(self, source: Features, target: Features) -> SoftCorrespondences:
        """Soft correspondences of B pairs; shapes, gradients and errors are those of ``torchreg.soft_match``."""
        return soft_match(
            source,
            target,
            method=self.method,
            temperature=self.temperature,
            dustbin=self.dustbin,
            iterations=self.iterations,
        )

    def extra_repr(self) -> str:
        """What ``print`` shows."""
        rounds = f", iterations={self.iterations}" if self.method == "sinkhorn" else ""
        return f"method={self.method!r}{rounds}, dustbin={self.dustbin is not None}"


class WeightedKabsch(nn.Module):
    """Least-squares poses over all pairs of points, weighted by confidence; optionally robust against wrong pairs.

    Args:
        rounds: of reweighting, in which pairs far apart under the last pose count less (``robust_kabsch``);
            0: plain least squares, where every wrong pair pulls.
        scale: meters, above 0, of the last round: a pair this far apart counts a quarter. About the distance up to
            which a pair is an inlier. Needed with rounds unless ``forward`` is given one.

    Raises:
        ValueError: numbers out of their range, or a scale without rounds.

    Example:
        >>> import torch, torchreg as tr
        >>> cloud = tr.Clouds(torch.rand(3, 3))
        >>> rows = tr.Features(torch.eye(3), torch.tensor([0, 3]), (("any", 3),), torch.tensor([True, True, True]))
        >>> tr.nn.WeightedKabsch()(cloud, cloud, tr.soft_match(rows, rows)).shape
        torch.Size([1, 4, 4])
    """

    @checked
    def __init__(self, *, rounds: int = 0, scale: float | None = None) -> None:
        super().__init__()
        self.rounds = at_least(rounds, "rounds", 0)
        expect(scale is None or rounds > 0, "scale", "None without rounds, which alone read it", scale)
        self.scale = None if scale is None else positive(scale, "scale")

    @full_precision
    def forward(
        self, source: Clouds, target: Clouds, matches: SoftCorrespondences, *, scale: Tensor | None = None
    ) -> Tensor:
        """Solve the pose of every pair.

        Args:
            source: B clouds.
            target: B clouds.
            matches: of their points.
            scale: (B,) meters, in place of the module's.

        Returns:
            T_target_source (B, 4, 4) float64, meters, origins included, as in ``RegistrationResult``; solved in the
            dtype of the points. A pair without any confidence, such as one with an empty cloud, gets some pose, since
            all fit alike, and nothing but the sum of its confidence, 0, says so. Gradients flow to points and
            confidences, finite everywhere.

        Raises:
            ValueError: clouds other than those of the matches, or no scale for the rounds.
        """
        sides = (("source", source, matches.source_offsets), ("target", target, matches.target_offsets))
        for name, side, offsets in sides if not torch.compiler.is_compiling() else ():
            same = torch.equal(side.offsets, offsets)
            expect(same, name, f"the clouds of the matches, {offsets.tolist()}", side.offsets.tolist())
        scales = self._scales(len(source), scale, source.points)
        rows = (spans(side.offsets, side.points.shape[0]) for side in (source, target))
        poses = [
            self._solve(source.points[i:j], target.points[k:m], confidence.to(source.points), scales[b])
            for b, ((i, j), (k, m), confidence) in enumerate(zip(*rows, matches.confidence, strict=True))
        ]
        T = torch.stack(poses).double() if poses else source.origin.new_zeros(0, 4, 4)
        R = T[:, :3, :3]
        return rigid(R, T[:, :3, 3] - apply_rotation(R, source.origin) + target.origin)

    def _solve(self, source: Tensor, target: Tensor, confidence: Tensor, scale: Tensor) -> Tensor:
        if self.rounds == 0:
            return soft_kabsch(source, target, confidence)
        return robust_kabsch(source, target, confidence, scale=scale, rounds=self.rounds)

    def _scales(self, pairs: int, scale: Tensor | None, like: Tensor) -> Tensor:
        """(B,) of the dtype and device of the points."""
        if scale is not None:
            expect(self.rounds > 0, "scale", "None without rounds, which alone read it", scale)
            expect_shape(scale, "scale", (pairs,))
            if not transformed(scale):
                known = scale.detach()
                fits = bool((torch.isfinite(known) & (known > 0)).all())
                expect(fits, "scale", "finite numbers above 0", known.tolist())
            return scale.to(like)
        expect(self.rounds == 0 or self.scale is not None, "scale", "one per pair, as the module has none", scale)
        return like.new_full((pairs,), self.scale or 0.0)

    def extra_repr(self) -> str:
        """What ``print`` shows."""
        return f"rounds={self.rounds}, scale={self.scale}"


def _of_float32(values: float | list[float]) -> Tensor:
    """Weights to begin with, of one dtype whatever the default is."""
    return torch.tensor(values, dtype=torch.float32)
