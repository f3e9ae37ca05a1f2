"""Judge transforms that came from elsewhere: from another program, a guess, a survey.

describe, match, solve, rivals          as ``register`` does, so that better poses and look-alikes are known
-> weigh, refine, judge                 with the given pose among the candidates (``find_poses``)
-> verdict on the given pose            ``verification/given.py``
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from torchreg.entry import entry
from torchreg.errors import expect, one_of
from torchreg.geometry.numerics.threads import undisturbed
from torchreg.geometry.rigid_check import expect_rigid
from torchreg.metrics import pose_errors
from torchreg.registration.describe import describe_thin
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.plan import Plan, joined
from torchreg.registration.register import find_poses
from torchreg.registration.stopwatch import stopwatch
from torchreg.types import Clouds, RegistrationResult, Verification
from torchreg.verification import WORK
from torchreg.verification.given import GivenVerdict, moved_on
from torchreg.verification.reasons import Displacement


@entry
def verify(
    source: Clouds,
    target: Clouds,
    T_target_source: Tensor | ArrayLike,
    options: RegistrationOptions | Sequence[RegistrationOptions] | None = None,
    *,
    effort: str | None = None,
    refine: str | None = None,
    seed: int = 0,
    max_bytes: int | None = None,
) -> Verification:
    """Judge a given transform of every pair: how probable is it that it is right, and what speaks against it?

    The poses that ``register`` would find compete with the given one on the clouds, so that a wrong transform loses to
    a better one, and one of several look-alikes is told to be so. The given transform is right where the pose that it
    settles to when it is refined wins and is trusted, by the rule of ``register``, and where it lies within the inlier
    threshold of that pose, root mean square over the source's points.

    Args:
        source: B clouds.
        target: B clouds.
        T_target_source: (B, 4, 4), or (4, 4) for all pairs: rigid within 1e-4, x_target = R x_source + t in meters, in
            the frames of the files (origins included).
        options: as for ``register``; ``None`` derives them from the spacing of each pair's points.
        effort: ``"fast"``, ``"balanced"`` or ``"thorough"``, as for ``register``; ``None`` takes that of the options,
            and balanced where they are derived or plain, which weighs no pose.
        refine: as for ``register``; with "none" there are no residuals.
        seed: of every random draw, any integer. The same seed gives the same bits, for any batch and number of threads.
        max_bytes: as for ``register``.

    Returns:
        Verification. A pair of clouds that cannot be registered at all has ``success`` false and its ``failure``; it
        does not affect the others. No gradients.

    Raises:
        ValueError: transforms that are not finite or not rigid, different numbers of clouds, or options that do not
            fit.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=1.5)
        >>> verification = tr.verify(pair.source, pair.target, pair.T_target_source)
        >>> verification.probability.shape
        torch.Size([1])
    """
    T = _transforms(T_target_source, len(source)).to(source.device)
    with stopwatch() as seconds, undisturbed(source.points):
        effort = judging_effort(options, effort)
        plan = Plan(source, target, options, effort=effort, solver=None, refine=refine, max_bytes=max_bytes)
        found = []
        for pairs in plan.slices:
            described = plan.sides(pairs, describe_thin)
            found.append(find_poses(*described, plan.options[pairs], colored=plan.colored, seed=seed, T_given=T[pairs]))
    search = joined([part.result for part in found], seconds=seconds)
    residuals = torch.cat([part.residuals for part in found])
    return _verification(T, search, [verdict for part in found for verdict in part.given], residuals)


def _transforms(given: Tensor | ArrayLike, pairs: int) -> Tensor:
    """The given transforms (B, 4, 4) float64, checked."""
    name, expected = "T_target_source", f"({pairs}, 4, 4) numbers, or (4, 4) for all pairs"
    try:
        T = torch.as_tensor(given).detach().to(torch.float64)
    except (TypeError, ValueError, RuntimeError):
        T = torch.zeros(0)
        expect(False, name, expected, given)
    expect(T.shape in ((4, 4), (pairs, 4, 4)), name, expected, T)
    for b, each in enumerate(T if T.ndim == 3 else [T]):
        expect_rigid(each, f"{name}[{b}]" if T.ndim == 3 else name)
    return T.expand(pairs, 4, 4)


def judging_effort(
    options: RegistrationOptions | Sequence[RegistrationOptions] | None, effort: str | None
) -> str | None:
    """An effort at which poses are weighed on the clouds; ``None`` for that of the options."""
    if effort is not None:
        return one_of(effort, "effort", tuple(WORK))
    listed = [options] if isinstance(options, RegistrationOptions) else options
    first = listed[0] if isinstance(listed, Sequence) and len(listed) > 0 else None  # the efforts of all are the same
    plain = isinstance(first, RegistrationOptions) and first.effort not in WORK
    return "balanced" if plain else None


def _verification(
    T: Tensor, search: RegistrationResult, given: Sequence[GivenVerdict | None], residuals: Tensor
) -> Verification:
    """From the verdicts on the given poses; a pair without one has the failure of its search."""
    nowhere = torch.full((4, 4), math.nan, dtype=torch.float64, device=T.device)

    def numbers(of_none: float, values: Sequence[float | None]) -> Tensor:
        known = [of_none if value is None else value for value in values]
        return torch.tensor(known, dtype=torch.float64, device=T.device)

    def poses(name: str) -> Tensor:
        return torch.stack([nowhere if one is None else getattr(one, name).T_target_source for one in given])

    likeliest = poses("likeliest")
    for b, one in enumerate(given):
        if one is not None and bool(search.success[b]):
            likeliest[b] = search.T_target_source[b]  # the same pose, refined as register refines
    settled, given = _refined(T, search, given, poses("settled"))
    failure = tuple(
        early if verdict is None else verdict.failure for early, verdict in zip(search.failure, given, strict=True)
    )
    return Verification(
        T_target_source=T.contiguous(),
        success=torch.tensor([each is None for each in failure], device=T.device),
        failure=failure,
        probability=numbers(0.0, [one and one.pose.probability for one in given]),
        settled=settled,
        deviation_meters=numbers(math.nan, [one and one.displacement.meters for one in given]),
        deviation_degrees=numbers(math.nan, [one and one.displacement.degrees for one in given]),
        likeliest=likeliest,
        fitness=numbers(0.0, [one and one.fitness for one in given]),
        inlier_rmse=numbers(0.0, [one and one.inlier_rmse for one in given]),
        overlap=numbers(0.0, [one and one.pose.overlap for one in given]),
        residual_median=residuals[:, 0].clone(),
        residual_rms=residuals[:, 1].clone(),
        residual_95=residuals[:, 2].clone(),
        candidate=tuple(
            one and one.pose._replace(T_target_source=each) for one, each in zip(given, T.unbind(0), strict=True)
        ),
        settled_candidate=tuple(one and one.settled for one in given),
        rival=tuple(one and one.rival for one in given),
        search=search,
    )


def _refined(
    T: Tensor, search: RegistrationResult, given: Sequence[GivenVerdict | None], settled: Tensor
) -> tuple[Tensor, list[GivenVerdict | None]]:
    """The settled poses (B, 4, 4), refined where they are about the pose that the search refined, and the verdicts.

    From poses within the inlier threshold of each other, refinement comes to the same one.
    """
    settled, verdicts = settled.clone(), list(given)
    for b, verdict in enumerate(given):
        if verdict is None or search.residual_median is None or not bool(search.success[b]):
            continue
        source, threshold = search.source.select(b), search.options[b].inlier_threshold
        away = pose_errors(source, search.candidates[b][0].T_target_source, settled[b])
        if away.rmse_meters < threshold:
            settled[b] = search.T_target_source[b]
            moved = pose_errors(source, settled[b], T[b])
            verdicts[b] = moved_on(verdict, Displacement(moved.rmse_meters, moved.rre_degrees), threshold)
    return settled, verdicts
