"""What the surfaces of a pair of scans ask for, as a link that is believed; mixed with the link that the pair has."""

from __future__ import annotations

from dataclasses import replace

import torch

from torchreg.geometry.se3 import apply_rotation, compose, inverse, rigid
from torchreg.geometry.small_motions import cross_matrix, rotation_of, rotation_vector
from torchreg.refinement.measure import Measured
from torchreg.site.links import Link

_LOOSER = 1.0  # times the variance that a link gives a motion: beyond it, what else it stands on counts more


def tie(target: int, source: int, measured: Measured) -> Link:
    """What a pair asks for as a link that is believed."""
    return Link(
        target=target,
        source=source,
        T_target_source=measured.T_target_source.cpu(),
        log_odds=0.0,
        probability=0.5,
        covariance=measured.covariance.cpu(),
        center=measured.center.cpu(),
    )


def mixed(link: Link, measured: Measured) -> Link:
    """What the surfaces of a pair ask for, and in motions that they leave open, what its link says.

    In the axes in which both covariances are diagonal, each motion is that of the one or the other, with a smooth
    passage: the two are not independent, so that they must not be joined as if they were.
    """
    one = tie(link.target, link.source, measured)
    arm = torch.eye(6, dtype=torch.float64)
    arm[3:, :3] = -cross_matrix(one.center - link.center)
    root = torch.linalg.cholesky(arm @ link.covariance @ arm.t())
    half = torch.linalg.solve_triangular(root, one.covariance, upper=False)
    whitened = torch.linalg.solve_triangular(root, half.t(), upper=False)
    values, vectors = torch.linalg.eigh((whitened + whitened.t()) / 2)
    axes = root @ vectors
    D = compose(one.T_target_source, inverse(link.T_target_source))
    shift = apply_rotation(D[:3, :3], one.center) + D[:3, 3] - one.center
    off = torch.cat([rotation_vector(D[:3, :3]), shift])[:, None]
    along = vectors.t() @ torch.linalg.solve_triangular(root, off, upper=False)
    turn, moved = (axes @ (along / (1 + (values / _LOOSER).square())[:, None]))[:, 0].split(3)
    R = rotation_of(turn)
    T = compose(rigid(R, moved + one.center - apply_rotation(R, one.center)), link.T_target_source)
    covariance = (axes * values.clamp(min=1e-12, max=1.0)) @ axes.t()
    return replace(one, T_target_source=T, covariance=(covariance + covariance.t()) / 2)
