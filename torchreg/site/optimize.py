"""The poses of all scans by robust least squares on SE(3).

Minimized is the sum over links of rho(e^T C^-1 e), with e the turn and the shift between the poses and the link, C its
covariance and rho the loss of Geman and McClure, by Gauss-Newton steps at fixed weights. The loss begins as wide as the
start is far off and narrows step by step (graduated non-convexity: Yang, Antonante, Tzoumas and Carlone, RA-L 2020,
doi:10.1109/LRA.2020.2965893). Known poses keep their full weight.

Scans move by W -> W exp(x), each in its own frame. What ties a scan to the world alone, such as a control point, is one
more summand of the blocks on the diagonal and of the right side (``_system``).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply_rotation, compose, inverse, rigid
from torchreg.geometry.small_motions import cross_matrix, rotation_of
from torchreg.native import torch_on_one_thread
from torchreg.site.elimination import Elimination, Factor
from torchreg.site.graph import SiteGraph, residuals

GATE = 16.81
"""Squared deviations (chi-square of 6) that one right link in a hundred exceeds: the width of the loss."""

_MEDIAN = 5.35  # of chi-square of 6
_NARROWER = 2.0  # the factor by which the loss narrows at a step
_STEPS = 60
_BENT = 0.9  # the share of a link's resistance along its residual that the bend of the loss may take
_CLOSE = 0.01  # radians and meters, a step after which the bend is trusted
_FAINT = 1e-9  # the least weight, so that no scan comes loose


class SettledPoses(NamedTuple):
    """Poses, and how well they are known."""

    poses: Tensor  # (N + 1, 4, 4), node N being the world
    covariance: Tensor  # (N + 1, 6, 6) of a small turn about the zero of the node and a shift, in the node's frame
    weight: Tensor  # (L,) in (0, 1], how much of each link counts
    scale: float  # the factor, 1 or more, by which squared errors exceed what the covariances of links promise


class _System(NamedTuple):
    diagonal: Tensor  # (F, 6, 6)
    between: Tensor  # (E, 6, 6)
    right: Tensor  # (F, 6)


def settle_poses(graph: SiteGraph, start: Tensor, fixed: Tensor, *, least_step: float = 1e-9) -> SettledPoses:
    """Find the poses that links agree on.

    Args:
        graph: links that are believed, some of which may be wrong.
        start: (N + 1, 4, 4) float64, near the poses.
        fixed: (N + 1,) bool, nodes that stay: in every part of the graph that connects, one at least.
        least_step: radians and meters, a step below which the poses are settled.
    """
    with torch_on_one_thread():
        return _Problem(graph, fixed).settled(start, least_step)


class _Problem:
    """What stays the same from step to step."""

    def __init__(self, graph: SiteGraph, fixed: Tensor) -> None:
        self.graph = graph
        linked = torch.zeros_like(fixed)
        linked[graph.first] = linked[graph.second] = True
        self.free = (linked & ~fixed).nonzero()[:, 0]  # (F,)
        place = torch.full_like(fixed, -1, dtype=torch.int64)
        place[self.free] = torch.arange(len(self.free))
        self.first, self.second = place[graph.first], place[graph.second]  # (L,), -1 where fixed
        both = (self.first >= 0) & (self.second >= 0)
        self.both = both.nonzero()[:, 0]
        pairs = torch.stack([self.first[both], self.second[both]], dim=1)
        edges, self.edge = torch.unique(pairs, dim=0, return_inverse=True)
        self.edges = len(edges)
        self.elimination = Elimination(len(self.free), [(a, b) for a, b in edges.tolist()])
        self.redundancy = max(len(graph) - len(self.free), 0) / max(len(graph), 1)
        self.information = torch.cholesky_inverse(torch.linalg.cholesky(graph.covariance))

    def settled(self, start: Tensor, least_step: float) -> SettledPoses:
        poses, known = start.clone(), self.graph.known
        e = residuals(self.graph, poses)
        scale, width, moved = 1.0, 1.0, torch.inf
        if not bool(known.all()):
            width = max(1.0, self._reach(e))
        for _ in range(_STEPS):
            system = self._system(poses, e, scale, width, curved=width == 1.0 and moved < _CLOSE)
            factors = _factored(self.elimination, system)
            step = self.elimination.solve(factors, system.right)
            poses[self.free] = compose(poses[self.free], rigid(rotation_of(step[:, :3]), step[:, 3:]))
            e = residuals(self.graph, poses)
            moved = float(step.abs().max()) if len(step) else 0.0
            if width == 1.0 and moved < least_step:
                break
            scale = self._scale(e)
            width = max(1.0, min(width / _NARROWER, self._reach(e) / scale))
        covariance = torch.zeros(len(poses), 6, 6, dtype=torch.float64)
        system = self._system(poses, e, scale, 1.0, curved=False)
        covariance[self.free] = self.elimination.marginals(_factored(self.elimination, system))
        return SettledPoses(poses, covariance, self._weights(self._squares(e), scale, 1.0), scale)

    def _squares(self, e: Tensor) -> Tensor:
        """Squared deviations (L,) of residuals (L, 6)."""
        return (e[:, None] @ self.information @ e[:, :, None])[:, 0, 0]

    def _reach(self, e: Tensor) -> float:
        """How many times wider than ``GATE`` nine in ten squared deviations of links need the loss."""
        return float(torch.quantile(self._squares(e)[~self.graph.known], 0.9)) / GATE

    def _weights(self, squares: Tensor, scale: float, width: float) -> Tensor:
        bound = GATE * scale * width
        weight = (bound / (bound + squares)).square().clamp(min=_FAINT)
        return torch.where(self.graph.known, 1.0, weight)

    def _scale(self, e: Tensor) -> float:
        """How much larger squared errors are than promised, by their median; unknowns take up a share of them."""
        links = ~self.graph.known
        if self.redundancy < 0.1 or not bool(links.any()):
            return 1.0
        return max(1.0, float(self._squares(e)[links].median()) / (_MEDIAN * self.redundancy))

    def _system(self, poses: Tensor, e: Tensor, scale: float, width: float, *, curved: bool) -> _System:
        """The normal equations of all links at poses (N + 1, 4, 4); ``curved``: with the bend of the loss."""
        graph, squares = self.graph, self._squares(e)
        weight = torch.where(graph.known, 1.0, self._weights(squares, scale, width) / scale)[:, None, None]
        relative = compose(inverse(poses[graph.first]), poses[graph.second])
        R = relative[:, :3, :3]
        back = inverse(graph.T)
        beyond = apply_rotation(back[:, :3, :3], graph.center) + back[:, :3, 3]  # the center in the frame of second
        arm = apply_rotation(R, beyond)  # from the zero of second, axes of first
        at = arm + relative[:, :3, 3]  # where the poses put the center
        one, other = e.new_zeros(2, len(graph), 6, 6)
        one[:, :3, :3] = one[:, 3:, 3:] = -torch.eye(3, dtype=torch.float64)
        one[:, 3:, :3] = cross_matrix(at)
        other[:, :3, :3] = other[:, 3:, 3:] = R
        other[:, 3:, :3] = -cross_matrix(arm) @ R
        steep = self.information @ e[:, :, None]  # (L, 6, 1)
        force = weight * steep
        stiff = weight * self.information
        if curved:  # the loss is flatter along e (Triggs et al., Bundle adjustment, 2000), but it must not bend down
            bend = torch.minimum(4 / (GATE * scale * width + squares), _BENT / squares.clamp(min=1e-12))
            bend = torch.where(graph.known, 0.0, bend)[:, None, None]
            stiff = stiff - weight * bend * steep @ steep.transpose(1, 2)
        pull, push = one.transpose(1, 2) @ stiff, other.transpose(1, 2) @ stiff
        count = len(self.free)
        diagonal, right = e.new_zeros(count + 1, 6, 6), e.new_zeros(count + 1, 6)  # the last row is that of fixed nodes
        for place, side, J in ((self.first, pull, one), (self.second, push, other)):
            rows = torch.where(place < 0, count, place)
            diagonal.index_add_(0, rows, side @ J)
            right.index_add_(0, rows, -(J.transpose(1, 2) @ force)[:, :, 0])
        between = e.new_zeros(self.edges, 6, 6)
        between.index_add_(0, self.edge, (pull @ other)[self.both])
        return _System(diagonal[:count], between, right[:count])


def _factored(elimination: Elimination, system: _System) -> list[Factor]:
    """The factors of a system; where rounding spoils it, with a little more on the diagonal."""
    more = 0.0
    while True:
        diagonal = system.diagonal + more * torch.diag_embed(torch.diagonal(system.diagonal, dim1=1, dim2=2))
        factors = elimination.factor(diagonal, system.between)
        if factors is not None:
            return factors
        more = max(1e-12, more * 100)
