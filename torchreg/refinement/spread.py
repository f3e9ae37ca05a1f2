"""Residuals of surfels against the surfels they lie on, their spread, and the normal equations that they make.

A surfel has a distance to the plane of its partner, and where colors take part a difference of intensity, as in colored
ICP (Park, Zhou and Koltun, ICCV 2017, doi:10.1109/ICCV.2017.25): that of the point of the partner's plane on which it
lies, by the gradient there. Each kind is divided by its own spread, so neither needs a weight.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.roots import square_root
from torchreg.native import call, native
from torchreg.refinement.blocks import Blocks, dot
from torchreg.refinement.correspond import Correspondence
from torchreg.refinement.gauss_newton import CHANNELS, products
from torchreg.refinement.kernels import tukey
from torchreg.refinement.point_to_plane import jacobian
from torchreg.types.packing import offsets_of

CUT = 3.0
"""Standard deviations of the residuals, beyond which they have no weight."""

_DEVIATION = 1.4826  # standard deviation of normal numbers to their median absolute value
FAINT = 1e-3
"""Of full intensity: what varies less is one color."""


class Shades(NamedTuple):
    """Intensities of surfels beside those of their partners; float64."""

    difference: Tensor  # (k, 256) of the surfel less its place on the partner's plane, exposures made alike
    slope: Tensor  # (3, k, 256) by which it changes with the surfel's place, per meter
    contrast: Tensor  # (B,) standard deviation of the partners' intensities, of every pair


class Residuals(NamedTuple):
    """Surfels of the sources and the planes of their partners, k blocks of 256 rows; float64."""

    distance: Tensor  # (k, 256) meters, of the means to the partners' planes
    variance: Tensor  # (k, 256) squared meters, that the noise of both surfels gives it
    normal: Tensor  # (3, k, 256) of the partners
    turned: Tensor  # (3, k, 256) of the sources' surfels, turned into the target's frame, of either sign
    alike: Tensor  # (k, 256) bool, whether the two are within reach and face alike
    shades: Shades | None = None  # where colors take part


class ResidualSpread(NamedTuple):
    """How far the surfels of B pairs lie from the planes of their partners, but for those that have none."""

    scale: Tensor  # (B,) float64, standard deviation of the residuals in units of their ``deviations``
    excess: Tensor  # (B,) squared meters, the variance that noise alone does not explain: scans are bent, things moved
    shade: Tensor | None = None  # (B,) standard deviation of the differences of intensity


def deviations(shown: Residuals, spread: ResidualSpread, blocks: Blocks) -> Tensor:
    """The standard deviations (n, 256) of the residuals by noise and excess, meters."""
    return square_root(shown.variance + spread.excess[blocks.pair][:, None])


def residual_spread(shown: Residuals, blocks: Blocks) -> ResidualSpread:
    """The spread of every pair, from medians, which what moved does not reach."""
    distance = shown.distance.abs()
    whole = (_DEVIATION * medians(distance, shown.alike, blocks)).square()
    excess = (whole - medians(shown.variance, shown.alike, blocks)).clamp(min=0)
    relative = distance / deviations(shown, ResidualSpread(excess, excess), blocks)
    scale = (_DEVIATION * medians(relative, shown.alike, blocks)).clamp(min=1e-12)
    if shown.shades is None:
        return ResidualSpread(scale, excess)
    return ResidualSpread(scale, excess, _DEVIATION * medians(shown.shades.difference.abs(), shown.alike, blocks))


def medians(values: Tensor, kept: Tensor, blocks: Blocks) -> Tensor:
    """Medians (B,) of values (n, 256) where ``kept``; 0 where a pair has none."""
    if native(values, kept):
        return _medians_compiled(values, kept, blocks)
    ends = torch.tensor(blocks.counts).cumsum(0).tolist()
    found = []
    for end, count in zip(ends, blocks.counts, strict=True):
        rows = slice(end - count, end)
        own = values[rows][kept[rows]]
        found.append(own.median() if len(own) > 0 else values.new_zeros(()))
    return torch.stack(found)


def _medians_compiled(values: Tensor, kept: Tensor, blocks: Blocks) -> Tensor:
    """As ``medians``."""
    out = values.new_empty(len(blocks.counts))
    call("block_medians", values.contiguous(), kept.contiguous(), offsets_of(blocks.counts), len(out), out)
    return out


def normal_equations(shown: Residuals, matches: Correspondence, spread: ResidualSpread) -> Tensor:
    """The sums (B, 28) of the normal equations."""
    blocks = matches.blocks
    deviation = deviations(shown, spread, blocks)
    if native(deviation) and shown.shades is None:
        return _equations_compiled(shown, matches, deviation, CUT * spread.scale)
    cut = CUT * spread.scale[blocks.pair][:, None]

    def terms(chunk: slice) -> Tensor:
        distance, unit = shown.distance[chunk], deviation[chunk]
        weight = tukey(distance / unit, cut[chunk]) * shown.alike[chunk] / (unit * unit)
        moved = matches.moved[:, chunk]
        out = products(jacobian(moved, shown.normal[:, chunk], distance), weight)
        if shown.shades is None or spread.shade is None:
            return out
        difference = shown.shades.difference[chunk]
        faint = spread.shade[blocks.pair[chunk]][:, None]
        unit = faint.clamp(min=FAINT)
        # in units of the distances, which are not yet divided by their scale
        strength = (spread.scale[blocks.pair[chunk]][:, None] / unit).square() * (faint >= FAINT)
        weight = tukey(difference, CUT * unit) * shown.alike[chunk] * strength
        return products(jacobian(moved, shown.shades.slope[:, chunk], difference), weight, onto=out)

    return blocks.sums(terms, CHANNELS)


def _equations_compiled(shown: Residuals, matches: Correspondence, deviation: Tensor, cut: Tensor) -> Tensor:
    """As ``normal_equations``, without shades; ``cut`` (B,)."""
    blocks = matches.blocks
    sums = cut.new_empty(len(cut), CHANNELS)
    call(
        "surfel_equations",
        matches.moved,
        shown.normal,
        shown.distance,
        deviation,
        shown.alike,
        cut,
        blocks.pair,
        offsets_of(blocks.counts),
        len(blocks.pair),
        len(cut),
        sums,
    )
    return sums


def shades_of(intensity: Tensor, matches: Correspondence, columns: Tensor, alike: Tensor, normal: Tensor) -> Shades:
    """The shades of surfels of these intensities (n, 256).

    ``columns`` (4, n, 256) are of their partners the gradient of intensity, per meter, and the intensity itself. The
    source's intensities are brought to the median and the spread of their partners' first: exposures differ.
    """
    blocks, own = matches.blocks, columns[3]
    middles = [medians(values, alike, blocks)[blocks.pair][:, None] for values in (intensity, own)]
    contrasts = [
        medians((values - middle).abs_(), alike, blocks)
        for values, middle in zip((intensity, own), middles, strict=True)
    ]
    spreads = [contrast[blocks.pair][:, None] for contrast in contrasts]
    gain = torch.where(spreads[0] > FAINT, spreads[1] / spreads[0].clamp(min=FAINT), 1.0)
    across = dot(columns[:3], normal)
    slope = columns[:3] - across * normal  # along the plane
    ahead = dot(slope, matches.moved - matches.partner[:3])
    difference = (intensity - middles[0]) * gain + middles[1] - own - ahead
    return Shades(difference, -slope, _DEVIATION * contrasts[1])
