"""Random rigid motion, and noise on positions."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from torchreg.arguments import checked
from torchreg.augment.augmentation import Augmentation, Tracked, checked_size, unmoved
from torchreg.errors import one_of
from torchreg.geometry.se3 import apply_rotation, rigid, transform
from torchreg.types import Clouds

_AXES = ("any", "up")


class RandomMotion(Augmentation):
    """Rotates every cloud about its ``origin`` and shifts it.

    Points, normals, viewpoint and origin move together, in float64; gradients flow to points, normals and viewpoint.
    About the axis ``"any"``, rotations are uniform over all those of at most ``angle`` (the Haar measure on SO(3),
    whose density over the angle is 1 - cos), so that 180 degrees gives uniform rotations; about ``"up"`` only the
    heading changes, as between two scanners that stand level, uniformly within plus and minus ``angle``.

    Args:
        angle: degrees, the largest rotation, in [0, 180].
        shift: meters, the radius of the ball from which shifts are drawn uniformly.
        axis: ``"any"`` or ``"up"``, the z axis.
        probability, generator: as for ``Augmentation``.

    Raises:
        ValueError: an argument out of its range.

    Example:
        >>> cloud = Clouds(torch.rand(5, 3))
        >>> moved = RandomMotion(generator=torch.Generator().manual_seed(0)).tracked(cloud)
        >>> torch.allclose(transform(cloud, moved.T_new_old).points, moved.clouds.points)
        True
    """

    @checked
    def __init__(
        self,
        *,
        angle: float = 180.0,
        shift: float = 1.0,
        axis: str = "any",
        probability: float = 1.0,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__(probability=probability, generator=generator)
        self.angle = checked_size(angle, "angle", "degrees", 180)
        self.shift = checked_size(shift, "shift", "meters")
        self.axis = one_of(axis, "axis", _AXES)

    def one(self, cloud: Clouds, draw: torch.Generator) -> Tracked:
        """Move one cloud."""
        largest = math.radians(self.angle)
        numbers = torch.rand(2, generator=draw, dtype=torch.float64).tolist()
        axis, direction = torch.nn.functional.normalize(torch.randn(2, 3, generator=draw, dtype=torch.float64), dim=1)
        if self.axis == "up":
            axis, angle = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64), (2 * numbers[0] - 1) * largest
        else:
            angle = _haar_angle(numbers[0], largest)
        R = _about(axis, angle).to(cloud.device)
        t = (self.shift * numbers[1] ** (1 / 3) * direction).to(cloud.device)
        origin = cloud.origin[0]
        T = rigid(R, origin - apply_rotation(R, origin) + t)[None]
        return Tracked(transform(cloud, T), T)


class Jitter(Augmentation):
    """Moves every point by normal noise, independent along x, y and z, cut off at ``clip`` deviations.

    Normals and colors stay. Gradients flow to points. The noise is drawn on the CPU, so that it is the same on every
    device.

    Args:
        sigma: meters, the standard deviation before it is cut off.
        clip: standard deviations, the farthest that a coordinate moves.
        probability, generator: as for ``Augmentation``.

    Raises:
        ValueError: an argument out of its range.

    Example:
        >>> noisy = Jitter(sigma=0.01, clip=2.0)(Clouds(torch.zeros(100, 3)))
        >>> bool(noisy.points.abs().max() <= 0.02)
        True
    """

    @checked
    def __init__(
        self,
        *,
        sigma: float = 0.005,
        clip: float = 3.0,
        probability: float = 1.0,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__(probability=probability, generator=generator)
        self.sigma = checked_size(sigma, "sigma", "meters")
        self.clip = checked_size(clip, "clip", "standard deviations")

    def one(self, cloud: Clouds, draw: torch.Generator) -> Tracked:
        """Add noise to the points of one cloud."""
        noise = torch.randn(len(cloud.points), 3, generator=draw, dtype=cloud.points.dtype)
        noise = self.sigma * noise.clamp_(-self.clip, self.clip)
        return Tracked(replace(cloud, points=cloud.points + noise.to(cloud.device)), unmoved(cloud))


def _haar_angle(share: float, largest: float) -> float:
    """The angle below which a ``share`` in [0, 1) of all rotations up to ``largest`` lies: a - sin a, by bisection."""
    if largest < 0.01:  # where the difference below is lost to rounding, and the cube is as good
        return largest * float(share ** (1 / 3))
    goal, low, high = share * (largest - math.sin(largest)), 0.0, largest
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if middle - math.sin(middle) < goal else (low, middle)
    return high


def _about(axis: Tensor, angle: float) -> Tensor:
    """The rotation (3, 3) float64 about a unit vector (3,) by radians: Rodrigues' formula."""
    x, y, z = axis.tolist()
    cross = torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=torch.float64)
    return torch.eye(3, dtype=torch.float64) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
