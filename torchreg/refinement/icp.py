"""Refine transforms that are about right: iterative closest point, batched over pairs.

Besl and McKay (PAMI 14(2), 1992, doi:10.1109/34.121791); the update and the rule to stop are those of Open3D's
``registration_icp`` (Zhou, Park and Koltun, arXiv:1801.09847), whose results it gives.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, partial

import torch
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import expect, expect_device, expect_floating, expect_in_words
from torchreg.geometry.numerics.threads import shared_out, undisturbed
from torchreg.geometry.rigid_check import expect_all_rigid
from torchreg.geometry.se3 import apply_rotation
from torchreg.native import kernel_threads
from torchreg.refinement.levels import refine_levels
from torchreg.refinement.loop import State
from torchreg.refinement.options import KINDS, IcpOptions
from torchreg.refinement.pairing import Pairing, among, centered_frames, enter, leave
from torchreg.refinement.result import IcpResult
from torchreg.types import Clouds, Failure

_SHARED_POINTS = 20_000
"""Source points from which threads share the pairs: 5 pairs of 600 points take twice as long on two as on one."""

_RIGID = 1e-3  # largest entry of R R^T - I that passes for rounding
_LARGEST = 1e100  # coordinates whose squares and their sums stay finite


@entry
def icp(
    source: Clouds,
    target: Clouds,
    T_target_source: Tensor,
    options: IcpOptions | Sequence[IcpOptions] | None = None,
) -> IcpResult:
    """Refine the transforms of B pairs.

    All computing is in float64, on points relative to the origins and about the clouds' centers. A pair's result
    has the same bits alone, in any batch and with any number of threads.

    Args:
        source: B clouds, with the colors and normals that the kind needs (``IcpOptions``).
        target: B clouds, likewise.
        T_target_source: (B, 4, 4), or (4, 4) for all pairs: where to start, rigid, meters, origins included.
        options: for all pairs, or one per pair; ``None`` is ``IcpOptions()``.

    Returns:
        IcpResult. A pair fails as data, with its ``failure``: points, normals, colors or a transform that are not
        finite, an empty cloud, no correspondences, correspondences that do not determine the motion. No gradients flow:
        inputs are detached.

    Raises:
        ValueError: sizes, dtypes or devices do not fit; normals or colors are missing; a transform that is finite and
            not rigid within 1e-3, such as a reflection.

    Example:
        >>> import torch
        >>> grid = torch.cartesian_prod(*[torch.arange(5.0)] * 3)
        >>> moved = Clouds(points=grid + 0.1)
        >>> result = icp(Clouds(points=grid), moved, torch.eye(4), IcpOptions(max_distance=0.5))
        >>> [round(x, 6) for x in result.T_target_source[0, :3, 3].tolist()]
        [0.1, 0.1, 0.1]
    """
    pairs = len(source)
    expect(len(target) == pairs, "target", f"{pairs} clouds, as the source has", len(target))
    expect_device(target.points, "target", source.device)
    expect(isinstance(T_target_source, Tensor), "T_target_source", "a tensor", T_target_source)
    expect(
        T_target_source.shape in ((4, 4), (pairs, 4, 4)),
        "T_target_source",
        f"(4, 4) or ({pairs}, 4, 4)",
        T_target_source,
    )
    expect_floating(T_target_source, "T_target_source")
    T = T_target_source.detach().to(source.device, torch.float64)
    finite = T.isfinite().all(dim=-1).all(dim=-1)[..., None, None]  # one that is not is a failure of its pair alone
    expect_all_rigid(torch.where(finite, T, torch.eye(4).to(T)), "T_target_source", _RIGID)
    T = T.expand(pairs, 4, 4)
    with undisturbed(source.points):
        return refine_pairs(source, target, Pairing(range(pairs), range(pairs)), T, _per_pair(options, pairs))


def refine_pairs(
    source: Clouds, target: Clouds, pairing: Pairing, T_target_source: Tensor, options: Sequence[IcpOptions]
) -> IcpResult:
    """Refine B pairs, several of which may share a cloud; shapes are not checked.

    Many starts on one pair of clouds are many pairs here. Each cloud is checked, centered, ordered and searched through
    one tree for all of them. A pair's result has the same bits as that of ``icp`` for this pair alone.

    Args:
        source: clouds with what the kinds need.
        target: likewise.
        pairing: which of them make up the B pairs.
        T_target_source: (B, 4, 4) float64: where to start.
        options: B of them; pairs that share a cloud have the same.
    """
    for kind in dict.fromkeys(option.kind for option in options):
        for side, name in KINDS[kind].needs:
            values = getattr(source if side == "source" else target, name)
            expect_in_words(values is not None, side, f"{name}, which kind={kind!r} needs", "none")
    source, target, T = source.detach(), target.detach(), T_target_source.detach()
    state = State.start(T, _defects(source, target, pairing, T, options))
    refined = T.clone()
    lengths = source.lengths
    sizes = [lengths[one] for one in pairing.source]
    several = source.device.type == "cpu" and sum(sizes) >= _SHARED_POINTS
    workers = kernel_threads() if several else 1
    groups = _groups(options, state.failed, pairing, sizes, workers)

    def run(members: list[int]) -> tuple[Tensor, State]:
        one, other, numbers = among(source, target, pairing, members)
        return _refine(one, other, numbers, T[members], [options[b] for b in members])

    results = shared_out(run, groups, workers) if workers > 1 else list(map(run, groups))
    for members, (moved, part) in zip(groups, results, strict=True):
        refined[members] = moved
        state.write(members, part)
    return IcpResult(
        T_target_source=refined,
        fitness=state.fitness,
        inlier_rmse=state.inlier_rmse,
        iterations=torch.tensor(state.iterations, dtype=torch.int64, device=T.device),
        converged=torch.tensor(state.converged, dtype=torch.bool, device=T.device),
        failure=tuple(
            failed or (None if converged else _still_moving(option.steps[-1].iterations))
            for failed, converged, option in zip(state.failed, state.converged, options, strict=True)
        ),
    )


def _still_moving(iterations: int) -> Failure:
    return Failure("not converged", f"still moving after {iterations} iterations", {"iterations": iterations})


def _groups(
    options: Sequence[IcpOptions],
    failed: Sequence[Failure | None],
    pairing: Pairing,
    sizes: Sequence[int],
    workers: int,
) -> list[list[int]]:
    """The pairs that can start, alike in kind, kernel and number of levels, in groups of about equal size.

    Pairs that share a target stay together.
    """
    groups: dict[tuple[str, str | None, int], dict[int, list[int]]] = {}
    for b, option in enumerate(options):
        if not failed[b]:
            by_target = groups.setdefault((option.kind, option.kernel, len(option.steps)), {})
            by_target.setdefault(pairing.target[b], []).append(b)
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
    """Transforms (B, 4, 4) and states of the pairs of one batch."""
    frames = centered_frames(source, target, pairing)
    state = State.start(T, [None] * len(T))
    state.rotation[:], state.translation[:] = enter(frames, T)
    refine_levels(source, target, pairing, frames, options, state)
    updated = torch.tensor([count > 0 for count in state.iterations], device=T.device)[:, None, None]
    return torch.where(updated, leave(frames, state.rotation, state.translation), T), state


def _per_pair(options: IcpOptions | Sequence[IcpOptions] | None, pairs: int) -> list[IcpOptions]:
    """The options of every pair."""
    if options is None or isinstance(options, IcpOptions):
        return [options or IcpOptions()] * pairs
    expect(isinstance(options, Sequence), "options", "IcpOptions or a sequence of them", options)
    listed = list(options)
    expect(len(listed) == pairs, "options", f"one, or one per pair ({pairs})", len(listed))
    for option in listed:
        expect(isinstance(option, IcpOptions), "options", "IcpOptions or a sequence of them", option)
    return listed


def _defects(
    source: Clouds, target: Clouds, pairing: Pairing, T: Tensor, options: Sequence[IcpOptions]
) -> list[Failure | None]:
    """Why every pair cannot start, ``None`` where it can."""
    finite = torch.isfinite(T).all(dim=2).all(dim=1).tolist()
    R = T[:, :3, :3]
    square = apply_rotation(R[:, None], R)  # (B, 3, 3): R R^T, transposed
    unit = ((square - torch.eye(3, dtype=T.dtype, device=T.device)).abs() < _RIGID).all(dim=2).all(dim=1)
    rigid = (unit & (T[:, 3] == T.new_tensor([0.0, 0.0, 0.0, 1.0])).all(dim=1)).tolist()
    defect = cache(partial(_defect, source, target))
    defects: list[Failure | None] = []
    for b, (one, other, option) in enumerate(zip(*pairing, options, strict=True)):
        if not finite[b]:
            defects.append(Failure("not finite", "the transform to start from is not finite"))
        elif not rigid[b]:
            defects.append(Failure("not rigid", "the transform to start from is not rigid"))
        else:
            defects.append(defect("source", one, option.kind) or defect("target", other, option.kind))
    return defects


def _defect(source: Clouds, target: Clouds, side: str, number: int, kind: str) -> Failure | None:
    """Why one cloud of a side cannot be refined by a kind of ICP, ``None`` where it can."""
    clouds = source if side == "source" else target
    begin, end = clouds.offsets[number : number + 2].tolist()
    if begin == end:
        return Failure("too few points", f"the {side} is empty")
    needed = {"points": clouds.points[begin:end], "origin": clouds.origin[number]}
    needed |= {name: getattr(clouds, name)[begin:end] for of_side, name in KINDS[kind].needs if of_side == side}
    for name, values in needed.items():
        if not bool((values.abs() < _LARGEST).all()):
            return Failure("not finite", f"the {side} has {name} that are not finite")
    return None
