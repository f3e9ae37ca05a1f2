"""The whole pipeline: two batches of clouds in, their transforms out."""

from __future__ import annotations

from collections.abc import Sequence

from torchreg.errors import expect, expect_device
from torchreg.registration.joined import joined
from torchreg.registration.match_and_solve import register_described
from torchreg.registration.pair_options import options_of_pairs
from torchreg.registration.sides import Sides
from torchreg.registration.slices import budget, pair_bytes, slices
from torchreg.registration.stopwatch import Stopwatch
from torchreg.types import Clouds, RegistrationOptions, RegistrationResult


def register(
    source: Clouds,
    target: Clouds,
    options: RegistrationOptions | Sequence[RegistrationOptions] | None = None,
    *,
    effort: str | None = None,
    solver: str | None = None,
    seed: int = 0,
    max_bytes: int | None = None,
) -> RegistrationResult:
    """Find the rigid transform of every pair, without a first guess.

    The paper's procedure (section 3.2): downsample, normals, FPFH, color histograms, fusion, mutual matches,
    hypotheses from them. Beyond the paper, the poses of several sets of features compete: they are weighed on the
    clouds themselves, refined by ICP, and the winner is judged (``effort``).

    A cloud that stands in several pairs is described once for every set of lengths that its pairs have.

    Args:
        source: B clouds.
        target: B clouds.
        options: in meters, for all pairs or one per pair (which then differ in lengths only); ``None`` derives
            them from the spacing of each pair's points (``derive_options``); ``PAPER`` has the paper's.
        effort: ``"plain"`` (the paper's procedure and no more), ``"fast"``, ``"balanced"`` or ``"thorough"``, as
            in ``RegistrationOptions``; ``None`` takes the options' own: balanced where they are derived, plain
            in ``PAPER``.
        solver: ``"ransac"`` or ``"compatibility"``; ``None`` takes the options' own.
        seed: of every random draw. The same seed gives the same bits, for any batch and number of threads.
        max_bytes: about the memory to work in, beyond the clouds, the result, and the descriptions of clouds that
            later pairs need again; ``None`` takes a quarter of what is free. A batch that needs more goes in slices,
            with the same result; one pair takes what it needs.

    Returns:
        RegistrationResult with the options, notes and times of the run. A pair that cannot be registered has
        ``success`` false and says why; the others are not touched by it. No gradients.

    Raises:
        ValueError: different numbers of clouds, or options that do not fit.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=1.5)
        >>> result = tr.register(pair.source, pair.target)
        >>> result.T_target_source.shape
        torch.Size([1, 4, 4])
    """
    expect(len(source) == len(target), "target", f"{len(source)} clouds, as the source has", len(target))
    expect(len(source) > 0, "source", "at least one cloud", len(source))
    expect_device(target.points, "target", source.device)
    expect(target.points.dtype == source.points.dtype, "target", f"points in {source.points.dtype}", target.points)
    most = budget(max_bytes, source.device)
    watch = Stopwatch()
    sides = Sides(source.detach(), target.detach())
    per_pair = options_of_pairs(*sides.usable(), options, effort, solver, sides.numbers)
    watch.lap("options")

    sides.thin(per_pair, watch)
    results = []
    for rows in slices([pair_bytes(size, per_pair[0]) for size in sides.sizes()], most):
        described = sides.described(rows, watch, most)
        results.append(register_described(*described, per_pair[rows], seed=seed, watch=watch))
    return joined(results, seconds=watch.laps())
