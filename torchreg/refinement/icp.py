"""Refine transforms that are about right: iterative closest point, batched over pairs.

Besl and McKay (PAMI 14(2), 1992, doi:10.1109/34.121791); the update and the rule to stop are those of Open3D's
``registration_icp`` (Zhou, Park and Koltun, arXiv:1801.09847), whose results it gives.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import torch
from torch import Tensor

from torchreg.errors import expect, expect_device, expect_floating
from torchreg.refinement.checks import broken, expect_attributes, per_pair
from torchreg.refinement.frames import centered_frames, enter, leave
from torchreg.refinement.levels import refine_levels, write
from torchreg.refinement.loop import State
from torchreg.refinement.options import IcpOptions
from torchreg.refinement.result import IcpResult
from torchreg.types import Clouds

_SHARED_POINTS = 20_000
"""Source points from which threads share the pairs: 5 pairs of 600 points take twice as long on two as on one."""


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
        source: B clouds; colors for ``kind="colored"``.
        target: B clouds; normals for ``kind="point_to_plane"`` and ``"colored"``, colors for the latter.
        T_target_source: (B, 4, 4), or (4, 4) for all pairs: where to start, rigid, meters, origins included.
        options: for all pairs, or one per pair; ``None`` is ``IcpOptions()``.

    Returns:
        IcpResult. A pair fails as data, with a reason: points, normals, colors or a transform that are not finite,
        an empty cloud, no correspondences, correspondences that leave the motion open. No gradients flow: inputs
        are detached.

    Raises:
        ValueError: sizes, dtypes or devices do not fit; normals or colors are missing.

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
    chosen = per_pair(options, pairs)
    for option in chosen:
        expect_attributes(source, target, option.kind)
    source, target = source.detach(), target.detach()
    T = T_target_source.detach().to(source.device, torch.float64).expand(pairs, 4, 4).clone()
    state = _start(T, broken(source, target, T, chosen))
    found = T.clone()
    groups = _groups(chosen, state.failed, source.lengths, _workers(source))

    def run(members: list[int]) -> tuple[Tensor, State]:
        return _refine(source.select(members), target.select(members), T[members], [chosen[b] for b in members])

    workers, threads = _workers(source), torch.get_num_threads()
    with ThreadPoolExecutor(workers) as pool:
        try:
            if workers > 1:  # each takes its operations one by one: threads within threads would wait for cores
                torch.set_num_threads(1)
            for members, (moved, part) in zip(groups, pool.map(run, groups), strict=True):
                found[members] = moved
                write(state, members, part)
        finally:
            torch.set_num_threads(threads)
    return IcpResult(
        T_target_source=found,
        fitness=state.fitness,
        inlier_rmse=state.inlier_rmse,
        iterations=torch.tensor(state.iterations, dtype=torch.int64, device=T.device),
        converged=torch.tensor(state.converged, dtype=torch.bool, device=T.device),
        reason=tuple(map(_reason, state.failed, state.converged, chosen)),
    )


def _workers(clouds: Clouds) -> int:
    """Threads that share the pairs on the CPU: as many as torch may use, one where the work is smaller than theirs."""
    shared = clouds.device.type == "cpu" and len(clouds.points) >= _SHARED_POINTS
    return torch.get_num_threads() if shared else 1


def _groups(
    options: Sequence[IcpOptions], failed: Sequence[str], sizes: Sequence[int], workers: int
) -> list[list[int]]:
    """The pairs that can begin, grouped by what a batch must share, every group in parts of about equal size."""
    groups: dict[object, list[int]] = {}
    for b, option in enumerate(options):
        if not failed[b]:
            groups.setdefault((option.kind, option.kernel, len(option.steps)), []).append(b)
    parts = []
    for members in groups.values():
        shares: list[list[int]] = [[] for _ in range(min(workers, len(members)))]
        for b in sorted(members, key=lambda b: -sizes[b]):
            min(shares, key=lambda share: sum(sizes[other] for other in share)).append(b)
        parts += [sorted(share) for share in shares if share]
    return parts


def _refine(source: Clouds, target: Clouds, T: Tensor, options: Sequence[IcpOptions]) -> tuple[Tensor, State]:
    """Transforms (B, 4, 4) and states of pairs that go as one batch."""
    frames = centered_frames(source, target)
    state = _start(T, [""] * len(T))
    state.rotation[:], state.translation[:] = enter(frames, T)
    refine_levels(source, target, frames, options, state)
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
