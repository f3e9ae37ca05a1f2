"""What the ways and methods share of one cloud and of one pair: a description, and matches.

    neighbors, normals -> descriptors of all methods -> matches of one method -> RANSAC, again and again

Where normals are turned to the scanner, transforms are those of ``register``, to the bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from torchreg.benchmark.paper.methods import METHODS, options_of
from torchreg.benchmark.paper.ways import unturned
from torchreg.descriptors.descriptor import Descriptor
from torchreg.matching import match_mutual
from torchreg.preprocess.downsample import in_morton_order
from torchreg.registration.describe import describe, description_of, hinted, oriented
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.recipes import fused_blocks
from torchreg.types import Clouds, Correspondences, Features


class MatchedSide(NamedTuple):
    """One cloud as all methods match it."""

    cloud: Clouds  # one, in Z order, its normals turned to its scanner
    blocks: Mapping[tuple[Descriptor, bool], Features]  # by descriptor, and by whether normals are turned


def described(cloud: Clouds, scale: float) -> MatchedSide:
    """Describe one colored cloud by the descriptors of all methods, with normals turned and unturned.

    ``scale`` is that of the lengths, as in ``options_of``.
    """
    options = [options_of(method, scale=scale) for method in METHODS]
    records = tuple(dict.fromkeys(record for option in options for record in option.descriptors))
    description = replace(description_of(options[0], colored=True), descriptors=records)
    turned, near = oriented(hinted(in_morton_order(cloud)), [description])
    blocks: dict[tuple[Descriptor, bool], Features] = {}
    for is_turned, cloud in ((True, turned), (False, unturned(turned, options[0]))):
        of_records = describe(cloud, near, [records])
        blocks |= {(record, is_turned): block for record, block in zip(records, of_records, strict=True)}
    return MatchedSide(turned, blocks)


def matched(source: MatchedSide, target: MatchedSide, options: RegistrationOptions, *, turned: bool) -> Correspondences:
    """Match two clouds by the descriptors of one method."""
    left, right = (
        fused_blocks(
            [side.blocks[record, turned] for record in options.descriptors],
            options.descriptors,
            options.weights,
            options.root,
        )
        for side in (source, target)
    )
    return match_mutual(left, right, ratio=options.ratio, neighbors=options.match_neighbors)
