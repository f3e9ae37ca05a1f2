"""Pairs made of clouds that several of them may share: what is done once a cloud, and who does which pairs.

Many starts on one pair of clouds are many pairs here. Each cloud is checked, centered, ordered and searched through
one tree for all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.numerics.threads import shared_out
from torchreg.refinement.checks import broken, expect_attributes
from torchreg.refinement.frames import centered_frames, enter, leave
from torchreg.refinement.levels import refine_levels, write
from torchreg.refinement.loop import State
from torchreg.refinement.options import IcpOptions
from torchreg.refinement.pairing import Pairing, among
from torchreg.refinement.result import IcpResult
from torchreg.types import Clouds

_SHARED_POINTS = 20_000
"""Source points from which threads share the pairs: 5 pairs of 600 points take twice as long on two as on one."""


def refine_pairs(
    source: Clouds, target: Clouds, pairing: Pairing, T_target_source: Tensor, options: Sequence[IcpOptions]
) -> IcpResult:
    """As ``icp``, of B pairs of clouds by their numbers; shapes are not checked.

    A pair's result has the same bits as that of ``icp`` with clouds of its own.

    Args:
        source: clouds with what the kinds need.
        target: likewise.
        pairing: which of them make up the B pairs.
        T_target_source: (B, 4, 4) float64: where to start.
        options: B of them; pairs that share a cloud have the same.
    """
    for kind in dict.fromkeys(option.kind for option in options):
        expect_attributes(source, target, kind)
    source, target, T = source.detach(), target.detach(), T_target_source.detach()
    state = _start(T, broken(source, target, pairing, T, options))
    found = T.clone()
    lengths = source.lengths
    sizes = [lengths[one] for one in pairing.source]
    workers = _workers(source, sum(sizes))
    groups = _groups(options, state.failed, pairing, sizes, workers)

    def run(members: list[int]) -> tuple[Tensor, State]:
        one, other, numbers = among(source, target, pairing, members)
        return _refine(one, other, numbers, T[members], [options[b] for b in members])

    done = shared_out(run, groups, workers) if workers > 1 else list(map(run, groups))
    for members, (moved, part) in zip(groups, done, strict=True):
        found[members] = moved
        write(state, members, part)
    return IcpResult(
        T_target_source=found,
        fitness=state.fitness,
        inlier_rmse=state.inlier_rmse,
        iterations=torch.tensor(state.iterations, dtype=torch.int64, device=T.device),
        converged=torch.tensor(state.converged, dtype=torch.bool, device=T.device),
        reason=tuple(map(_reason, state.failed, state.converged, options)),
    )


class _Kind(NamedTuple):
    """What pairs must share to go as one batch."""

    kind: str
    kernel: str | None
    levels: int


def _workers(clouds: Clouds, points: int) -> int:
    """Threads that share the pairs on the CPU: as many as torch may use, one where the work is smaller than theirs."""
    return torch.get_num_threads() if clouds.device.type == "cpu" and points >= _SHARED_POINTS else 1


def _groups(
    options: Sequence[IcpOptions], failed: Sequence[str], pairing: Pairing, sizes: Sequence[int], workers: int
) -> list[list[int]]:
    """The pairs that can begin, grouped by what a batch must share, every group in parts of about equal size.

    Pairs that share a target stay together.
    """
    groups: dict[_Kind, dict[int, list[int]]] = {}
    for b, option in enumerate(options):
        if not failed[b]:
            alike = groups.setdefault(_Kind(option.kind, option.kernel, len(option.steps)), {})
            alike.setdefault(pairing.target[b], []).append(b)
    parts = []
    for by_target in groups.values():
        work = {number: sum(sizes[b] for b in members) for number, members in by_target.items()}
        shares: list[list[int]] = [[] for _ in range(min(workers, len(work)))]
        load = [0] * len(shares)
        for number in sorted(work, key=lambda number: -work[number]):
            least = load.index(min(load))
            shares[least] += by_target[number]
            load[least] += work[number]
        parts += [sorted(share) for share in shares if share]
    return parts


def _refine(
    source: Clouds, target: Clouds, pairing: Pairing, T: Tensor, options: Sequence[IcpOptions]
) -> tuple[Tensor, State]:
    """Transforms (B, 4, 4) and states of pairs that go as one batch."""
    frames = centered_frames(source, target, pairing)
    state = _start(T, [""] * len(T))
    state.rotation[:], state.translation[:] = enter(frames, T)
    refine_levels(source, target, pairing, frames, options, state)
    updated = torch.tensor([count > 0 for count in state.iterations], device=T.device)[:, None, None]
    return torch.where(updated, leave(frames, state.rotation, state.translation), T), state


def _reason(failed: str, converged: bool, option: IcpOptions) -> str:
    still = f"still moving after {option.steps[-1].iterations} iterations"
    return failed or ("" if converged else still)


def _start(T: Tensor, failed: list[str]) -> State:
    pairs = len(failed)
    return State(
        rotation=T[:, :3, :3].clone(),
        translation=T[:, :3, 3].clone(),
        fitness=T.new_zeros(pairs),
        inlier_rmse=T.new_zeros(pairs),
        iterations=[0] * pairs,
        converged=[False] * pairs,
        failed=failed,
    )
