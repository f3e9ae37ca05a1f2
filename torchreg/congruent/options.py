"""How 4-point congruent sets are searched for."""

from __future__ import annotations

from dataclasses import dataclass

from torchreg.arguments import checked_record
from torchreg.errors import at_least, expect, fraction, positive
from torchreg.types.loading import loadable


@loadable
@checked_record
@dataclass(frozen=True, kw_only=True)
class Super4pcsOptions:
    """How poses are proposed by 4-point congruent sets. Lengths follow from the spacing of the points searched.

    Attributes:
        overlap: in (0, 1], the share of the source that is assumed to lie in the target: bases are at most this share
            of the source's diameter wide. Bases are the more telling the wider, and none that is wider than the
            overlap can be right.
        bases: how many bases of four points are looked for in the target, at most: the search ends with the pose under
            which the assumed overlap lies together.
        points: of each cloud that are searched, about: denser clouds are averaged over voxels first. Pairs of points,
            and the memory for them, grow with the square.
        threshold: in spacings of the points searched: lengths, crossings and points that differ by less agree.
        normal_degrees: in (0, 180], two normals agree within this angle; 180 leaves them out.
        color_distance: in sRGB, of [0, 1] a channel: two colors agree within this distance; ``None`` leaves them out.

    Raises:
        ValueError: a value out of its range.

    Example:
        >>> Super4pcsOptions(overlap=0.6).bases
        128
    """

    overlap: float = 0.4
    bases: int = 128
    points: int = 2000
    threshold: float = 0.75
    normal_degrees: float = 25.0
    color_distance: float | None = 0.5

    def __post_init__(self) -> None:
        fraction(self.overlap, "overlap")
        at_least(self.bases, "bases", 1)
        at_least(self.points, "points", 4)
        positive(self.threshold, "threshold")
        degrees = positive(self.normal_degrees, "normal_degrees")
        expect(degrees <= 180, "normal_degrees", "an angle of at most 180", self.normal_degrees)
        if self.color_distance is not None:
            positive(self.color_distance, "color_distance")
