"""From two sides that are described to their transforms: match, solve, decide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from torchreg.errors import expect
from torchreg.registration.decide import decide
from torchreg.registration.describe import expect_alike
from torchreg.registration.described import DescribedClouds
from torchreg.registration.inspect import pair_notes, refusal
from torchreg.registration.recipes import blocks_of, match, recipes_of, solve
from torchreg.registration.stopwatch import Stopwatch
from torchreg.types import RegistrationOptions, RegistrationResult, StageCounts
from torchreg.types.packing import spans
from torchreg.verification import ProposedPoses, proposals_of


def register_described(
    source: DescribedClouds,
    target: DescribedClouds,
    options: Sequence[RegistrationOptions],
    *,
    seed: int = 0,
    watch: Stopwatch | None = None,
) -> RegistrationResult:
    """Find the transform of every pair of described clouds: the second half of ``register``, with its results.

    Args:
        source: B clouds.
        target: B clouds.
        options: one per pair, complete, differing in lengths only, as both sides were described with.
        seed: of every random draw.
        watch: that counts the stages' times; ``None`` begins one.

    Returns:
        RegistrationResult; as ``register``'s.

    Raises:
        ValueError: the numbers of clouds or options differ, options differ in more than lengths, or descriptions lack
            what the options need.
    """
    pairs = len(source)
    expect(len(target) == pairs, "target", f"{pairs} clouds, as the source has", len(target))
    expect(len(options) == pairs, "options", f"one per pair ({pairs})", len(options))
    expect(pairs > 0, "source", "at least one cloud", pairs)
    expect_alike(options)
    watch = Stopwatch() if watch is None else watch
    facts = (source.facts, target.facts)
    refused = [refusal(one, other, option) for one, other, option in zip(*facts, options, strict=True)]
    source, target = _without(source, refused), _without(target, refused)
    colored = source.cloud.colors is not None and target.cloud.colors is not None
    recipes = recipes_of(options[0], colored)
    for name, side in (("source", source), ("target", target)):
        lacking = [block for block in ("fpfh", *blocks_of(recipes)) if block not in side.descriptors]
        expect(not lacking, name, f"descriptions with {', '.join(lacking)}", list(side.descriptors))
    sides = (source.descriptors, target.descriptors)
    clouds = (source.cloud, target.cloud)
    matches = [match(*sides, recipe, options[0].ratio, options[0].root) for recipe in recipes]
    watch.lap("matching")
    proposed = [
        ProposedPoses(recipe.words, found, solve(*clouds, found, recipe, options, seed))
        for recipe, found in zip(recipes, matches, strict=True)
    ]
    watch.lap("hypotheses")
    result = decide(*clouds, (source.spacing, target.spacing), proposed, options)
    watch.lap("decision")
    return replace(
        result,
        failure=tuple(early or late for early, late in zip(refused, result.failure, strict=True)),
        options=tuple(options),
        notes=tuple(map(pair_notes, *facts, options)),
        seconds=watch.laps(),
        stages=_stage_counts(source, target, proposed),
    )


def _without(side: DescribedClouds, refused: Sequence[object]) -> DescribedClouds:
    """The same clouds, those of refused pairs without points, so that they do not touch the others."""
    if not any(refused):
        return side
    parts = zip(side.unpack(), refused, strict=True)
    return DescribedClouds.pack([part.emptied() if reason else part for part, reason in parts])


def _stage_counts(
    source: DescribedClouds, target: DescribedClouds, proposed: Sequence[ProposedPoses]
) -> tuple[StageCounts, ...]:
    """What each stage of every pair had."""
    described = [
        [int(side.descriptors["fpfh"].valid[begin:end].sum()) for begin, end in spans(side.cloud.offsets)]
        for side in (source, target)
    ]
    points = (source.cloud.lengths, target.cloud.lengths)
    return tuple(
        StageCounts(
            given=(source.facts[b].points, target.facts[b].points),
            points=(points[0][b], points[1][b]),
            described=(described[0][b], described[1][b]),
            proposals=proposals_of(proposed, b),
        )
        for b in range(len(source))
    )
