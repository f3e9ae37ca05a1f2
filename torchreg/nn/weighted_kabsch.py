"""From soft correspondences to poses."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from torchreg.errors import at_least, expect, expect_shape, positive
from torchreg.geometry.numerics.derivatives import transformed
from torchreg.geometry.se3 import apply_rotation, rigid
from torchreg.geometry.soft_kabsch import robust_kabsch, soft_kabsch
from torchreg.nn.precision import full_precision
from torchreg.types import Clouds, SoftCorrespondences
from torchreg.types.packing import spans


class WeightedKabsch(nn.Module):
    """Least-squares poses over all pairs of points by their confidence, robust against wrong ones if wanted.

    Args:
        rounds: in which pairs far apart after the last pose count less (``robust_kabsch``); 0: plain least
            squares, where every wrong pair pulls.
        scale: meters, above 0, of the last round: a pair this far apart counts a quarter; about the distance at which
            a pair is an inlier. Needed with rounds unless ``forward`` is given one.

    Raises:
        ValueError: numbers out of their range, or a scale that no round would read.
    """

    def __init__(self, *, rounds: int = 0, scale: float | None = None) -> None:
        super().__init__()
        self.rounds = at_least(rounds, "rounds", 0)
        expect(scale is None or rounds > 0, "scale", "None without rounds, which alone read it", scale)
        self.scale = None if scale is None else positive(scale, "scale")

    @full_precision
    def forward(
        self, source: Clouds, target: Clouds, matches: SoftCorrespondences, *, scale: Tensor | None = None
    ) -> Tensor:
        """The pose of every pair.

        Args:
            source: B clouds.
            target: B clouds.
            matches: of their points.
            scale: (B,) meters, in place of the module's own.

        Returns:
            T_target_source (B, 4, 4) float64, meters, origins included, as in ``RegistrationResult``; solved in the
            dtype of the points. A pair without confidence anywhere has one of the rotations that fit as well as any.
            Gradients flow to points and confidences, finite everywhere.

        Raises:
            ValueError: clouds that the matches are not of, or no scale for the rounds.
        """
        for side, offsets, name in (
            (source, matches.source_offsets, "source"),
            (target, matches.target_offsets, "target"),
        ):
            expect(
                torch.equal(side.offsets, offsets),
                name,
                f"the clouds of the matches, {offsets.tolist()}",
                side.offsets.tolist(),
            )
        scales = self._scales(len(source), scale, source.points)
        poses = [
            self._solve(source.points[i:j], target.points[k:m], confidence.to(source.points), scales[b])
            for b, ((i, j), (k, m), confidence) in enumerate(
                zip(spans(source.offsets), spans(target.offsets), matches.confidence, strict=True)
            )
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
