"""A level frame: z is up, by what the scans themselves say about up."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from torchreg.errors import expect_shape
from torchreg.geometry.se3 import apply_rotation, compose, rigid
from torchreg.geometry.small_motions import rotation_of
from torchreg.site.placement import Placement

_APART = math.radians(5.0)  # between votes that are one


def level(placement: Placement, up: Tensor) -> Placement:
    """Turn the frame of every group so that z is up.

    Each scan has a vote, its own direction up under its pose. The vote that most others share within 5 degrees, more
    than half of all votes and at least half of the scans of the group, gives the direction, as the mean of those that
    share it. A frame without such a vote stays as it is, and so does that of known poses. The turn is the least one,
    about the zero of the frame.

    Args:
        placement: N scans.
        up: (N, 3) float64, the direction that is up in the frame of each scan, of any length; NaN where not known.

    Returns:
        The placement with its poses, centers and covariances in the turned frames.

    Raises:
        ValueError: another shape.

    Example:
        >>> from torchreg.site import Link, loose_covariance, place
        >>> T = torch.eye(4, dtype=torch.float64)
        >>> link = Link(target=0, source=1, T_target_source=T, log_odds=3.0, probability=0.9,
        ...             covariance=loose_covariance(0.01, 5.0))
        >>> y_up = torch.tensor([[0.0, 1.0, 0.0]] * 2, dtype=torch.float64)
        >>> level(place([link], 2), y_up).T_world_scan[0, 2].round(decimals=9).tolist()
        [0.0, 1.0, 0.0, 0.0]
    """
    expect_shape(up, "up", (len(placement), 3), torch.float64)
    turn = torch.eye(3, dtype=torch.float64).repeat(len(placement), 1, 1)
    votes = apply_rotation(placement.T_world_scan[:, :3, :3], torch.nn.functional.normalize(up, dim=1))
    votes = torch.where((up.abs().sum(dim=1) > 0)[:, None], votes, torch.nan)
    for group in range(int(placement.group.max()) + 1 if len(placement) else 0):
        members = placement.group == group
        said = votes[members & ~placement.in_world]
        direction = _shared(said[~said.isnan().any(dim=1)], int(members.sum()) / 2)
        if direction is not None:
            turn[members] = _to_z(direction)
    both = torch.zeros(len(placement), 6, 6, dtype=torch.float64)
    both[:, :3, :3] = both[:, 3:, 3:] = turn
    turned = compose(rigid(turn, torch.zeros(len(turn), 3, dtype=torch.float64)), placement.T_world_scan)
    return replace(
        placement,
        T_world_scan=torch.where((placement.group >= 0)[:, None, None], turned, torch.nan),
        center=apply_rotation(turn, placement.center),
        covariance=both @ placement.covariance @ both.transpose(1, 2),
    )


def _shared(votes: Tensor, least: float) -> Tensor | None:
    """The direction (3,) that more than half of the votes (K, 3) share, and at least ``least`` of them."""
    near = votes @ votes.t() >= math.cos(_APART)  # (K, K)
    most = int(near.sum(dim=1).max()) if len(votes) else 0
    if 2 * most <= len(votes) or most < least:
        return None
    chosen = votes[near[near.sum(dim=1).argmax()]]
    return torch.nn.functional.normalize(chosen.sum(dim=0), dim=0)


def _to_z(direction: Tensor) -> Tensor:
    """The least turn (3, 3) that takes a direction (3,) to z; about x where it points down."""
    axis = torch.stack([direction[1], -direction[0], torch.zeros_like(direction[0])])
    sine = torch.linalg.vector_norm(axis)
    if float(sine) < 1e-12:
        axis, sine = axis.new_tensor([1.0, 0.0, 0.0]), axis.new_tensor(0.0)
    else:
        axis = axis / sine
    return rotation_of(axis * torch.atan2(sine, direction[2]))
