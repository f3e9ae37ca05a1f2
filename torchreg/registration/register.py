"""The whole pipeline: two batches of clouds in, their transforms out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from torchreg.errors import expect, expect_device
from torchreg.registration.decide import decide, stage_counts
from torchreg.registration.describe import color_of_pairs, describe, downsample, oriented, without_lengths
from torchreg.registration.inspect import notes_on, refuse, set_aside, too_wide
from torchreg.registration.recipes import blocks_of, coarser, match, recipes_of, solve
from torchreg.registration.scale import derive_options
from torchreg.registration.stopwatch import Stopwatch
from torchreg.types import Clouds, RegistrationOptions, RegistrationResult
from torchreg.verification import Proposed


def register(
    source: Clouds,
    target: Clouds,
    options: RegistrationOptions | Sequence[RegistrationOptions] | None = None,
    *,
    effort: str | None = None,
    solver: str | None = None,
    seed: int = 0,
) -> RegistrationResult:
    """Find the rigid transform of every pair, without a first guess.

    The paper's procedure (section 3.2): downsample, normals, FPFH, color histograms, fusion, mutual matches,
    hypotheses from them. Beyond the paper, the poses of several sets of features compete: they are weighed on the
    clouds themselves, refined by ICP, and the winner is judged (``effort``).

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
    watch = Stopwatch()
    source, target = source.detach(), target.detach()
    given, refused = (source, target), refuse(source, target)
    source, target = set_aside(source, refused), set_aside(target, refused)
    per_pair = _options_of_pairs(source, target, options, effort, solver)
    refused = [early or late for early, late in zip(refused, too_wide(source, target, per_pair), strict=True)]
    source, target = set_aside(source, refused), set_aside(target, refused)
    recipes = recipes_of(per_pair[0], source.colors is not None and target.colors is not None)
    watch.lap("options")

    source, target = downsample(source, per_pair), downsample(target, per_pair)
    watch.lap("downsample")
    source, source_near = oriented(source, per_pair)
    target, target_near = oriented(target, per_pair)
    watch.lap("neighbors and normals")
    source_color, target_color = color_of_pairs(source, target, per_pair)
    source_described = describe(source, source_near, per_pair, source_color, blocks_of(recipes))
    target_described = describe(target, target_near, per_pair, target_color, blocks_of(recipes))
    watch.lap("descriptors")
    matches = [match(source_described, target_described, recipe, per_pair[0].ratio) for recipe in recipes]
    watch.lap("matching")
    proposed = [
        Proposed(recipe.words, found, solve(source, target, found, recipe, per_pair, seed))
        for recipe, found in zip(recipes, matches, strict=True)
    ]
    watch.lap("hypotheses")
    result = decide(source, target, (source_near, target_near), proposed, per_pair)
    watch.lap("decision")

    stages = stage_counts(given, (source, target), (source_described, target_described), proposed)
    return replace(
        result,
        reason=tuple(early or late for early, late in zip(refused, result.reason, strict=True)),
        options=per_pair,
        notes=notes_on(*given, per_pair),
        seconds=watch.laps(),
        stages=stages,
    )


def _options_of_pairs(
    source: Clouds,
    target: Clouds,
    options: RegistrationOptions | Sequence[RegistrationOptions] | None,
    effort: str | None,
    solver: str | None,
) -> tuple[RegistrationOptions, ...]:
    if options is None:
        per_pair = derive_options(source, target)
    elif isinstance(options, RegistrationOptions):
        per_pair = (options,) * len(source)
    else:
        listed = isinstance(options, Sequence) and all(isinstance(option, RegistrationOptions) for option in options)
        expect(listed, "options", "RegistrationOptions, one per pair or one for all", options)
        per_pair = tuple(options)
        expect(len(per_pair) == len(source), "options", f"one for all or one per pair ({len(source)})", len(per_pair))
    if effort is not None:
        per_pair = tuple(_with_effort(option, effort) for option in per_pair)
    if solver is not None:
        per_pair = tuple(replace(option, solver=solver) for option in per_pair)
    for option in per_pair[1:]:
        alike = without_lengths(option) == without_lengths(per_pair[0])
        expect(alike, "options", "options that differ in lengths only within one batch", option)
    return per_pair


def _with_effort(options: RegistrationOptions, effort: str) -> RegistrationOptions:
    """The options at another effort; those of a fast run stay as they are, so that a run can be repeated."""
    changed = replace(options, effort=effort)
    return coarser(changed) if effort == "fast" and options.effort != "fast" else changed
