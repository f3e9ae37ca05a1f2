"""PCFH with gradients: Eq. (3) and (4) of the paper over soft histograms of color differences."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.descriptors.soft.rows import Piece, PieceGradient, by_rows
from torchreg.descriptors.soft.spread import add_neighbors, distance_weights, scaled_gradient, scaled_to_100
from torchreg.descriptors.soft.votes import Shares, bin_shares, share_gradient, shared_votes
from torchreg.geometry.numerics.compiled import fusible
from torchreg.types import Neighborhoods

_HUE, _SATURATION = 0, 1


def soft_pcfh(
    points: Tensor,
    values: Tensor,
    near: Neighborhoods,
    enough: Tensor,
    *,
    bins: int,
    channels: tuple[int, ...],
    saturation_weighting: bool,
    bandwidth: float,
    edges: Tensor | None,
    neighbor_weights: Tensor | None,
) -> Tensor:
    """(P, bins x channels); the arguments are those of ``torchreg.pcfh``.

    ``channels`` are columns of ``values`` (hue 0, saturation 1, value 2), ``enough`` (P,) says whether a point has as
    many neighbors as a histogram needs.
    """

    weighted = tuple(channel == _HUE and saturation_weighting for channel in channels)

    def histograms(piece: Piece) -> Tensor:
        shares, votes = _shares(piece, bins, channels, bandwidth), _votes(piece, weighted)
        counts = [shared_votes(share, vote, bins) for share, vote in zip(shares, votes, strict=True)]
        return scaled_to_100(torch.stack(counts, dim=1)).flatten(1)

    def derivative(piece: Piece, grad: Tensor) -> PieceGradient:
        shares, votes = _shares(piece, bins, channels, bandwidth), _votes(piece, weighted)
        counts = torch.stack([shared_votes(share, vote, bins) for share, vote in zip(shares, votes, strict=True)], 1)
        of_counts = scaled_gradient(counts, grad.view(counts.shape))
        return _gradient(piece, shares, votes, of_counts, channels, weighted, bandwidth)

    if points.shape[0] == 0:
        return values.new_empty(0, bins * len(channels))
    settings = None if edges is None else edges.flatten()
    hhd = by_rows(histograms, values, near, neighbor_weights, settings, derivative=derivative)
    hhd = torch.where(enough[:, None], hhd, 0)
    weights = distance_weights(points, near, neighbor_weights)
    return torch.where(enough[:, None], add_neighbors(hhd, near, weights, len(channels)), 0)


def _shares(piece: Piece, bins: int, channels: tuple[int, ...], bandwidth: float) -> list[Shares]:
    """The bins between which the differences of every channel lie."""
    edges = None if piece.settings is None else piece.settings.view(piece.votes.shape[0], -1, bins + 1)
    return [
        _channel_shares(
            piece.query[channel],
            piece.neighbor[channel],
            channel == _HUE,
            bins,
            bandwidth,
            None if edges is None else edges[:, place],
        )
        for place, channel in enumerate(channels)
    ]


@fusible
def _channel_shares(
    query: Tensor, neighbor: Tensor, circular: bool, bins: int, bandwidth: float, edges: Tensor | None
) -> Shares:
    return bin_shares(soft_difference(query, neighbor, circular=circular), bins, bandwidth, edges=edges)


def _votes(piece: Piece, weighted: tuple[bool, ...]) -> list[Tensor]:
    """The votes (r, K) of every channel, by the saturation of both points where that is asked for."""
    by_saturation = (
        piece.votes * (piece.query[_SATURATION] * piece.neighbor[_SATURATION]) if any(weighted) else piece.votes
    )
    return [by_saturation if channel_weighted else piece.votes for channel_weighted in weighted]


def _gradient(
    piece: Piece,
    shares: list[Shares],
    votes: list[Tensor],
    of_counts: Tensor,
    channels: tuple[int, ...],
    weighted: tuple[bool, ...],
    bandwidth: float,
) -> PieceGradient:
    """From the gradient (r, channels, bins) of counts to that of colors and votes."""
    zero = torch.zeros_like(piece.votes)
    neighbor: list[Tensor] = [zero] * len(piece.neighbor)
    query = [zero[:, 0]] * len(piece.query)
    of_votes = zero
    for place, channel in enumerate(channels):
        columns = piece.query[channel], piece.neighbor[channel]
        of_value, level = _channel_gradient(
            *columns, channel == _HUE, votes[place], shares[place], of_counts[:, place], bandwidth
        )
        neighbor[channel] = neighbor[channel] + of_value
        query[channel] = query[channel] - of_value.sum(dim=1)
        if weighted[place]:
            a, b = piece.query[_SATURATION], piece.neighbor[_SATURATION]
            of_product = level * piece.votes
            neighbor[_SATURATION] = neighbor[_SATURATION] + of_product * a
            query[_SATURATION] = query[_SATURATION] + (of_product * b).sum(dim=1)
            level = level * (a * b)
        of_votes = of_votes + level
    return PieceGradient(tuple(query), tuple(neighbor), of_votes)


@fusible
def _channel_gradient(
    query: Tensor, neighbor: Tensor, circular: bool, votes: Tensor, shares: Shares, of_counts: Tensor, bandwidth: float
) -> tuple[Tensor, Tensor]:
    """The gradient (r, K) of a neighbor's value, and that of the votes."""
    part = share_gradient(shares, of_counts, bandwidth)
    difference = neighbor - query
    slope = torch.sign(difference)
    if circular:
        slope = slope * 2 * torch.sign(0.5 - difference.abs())
    return part.step * votes * slope * of_counts.shape[1], part.level


def soft_difference(query: Tensor, neighbor: Tensor, *, circular: bool) -> Tensor:
    """The difference of two values in [0, 1], scaled to [0, 1]; ``circular`` for hue.

    Continuous. At its kinks, equal values and opposite hues, the gradient is 0.
    """
    difference = (neighbor - query).abs()
    return torch.minimum(difference, 1 - difference) * 2 if circular else difference
