"""The whole pipeline: two batches of clouds in, their transforms out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch

from torchreg.errors import expect
from torchreg.matching import match_mutual
from torchreg.ransac import ransac
from torchreg.registration.describe import color_of_pairs, describe, downsample, oriented, without_lengths
from torchreg.registration.inspect import notes_on, refuse, set_aside
from torchreg.registration.scale import derive_options
from torchreg.registration.stopwatch import Stopwatch
from torchreg.types import Clouds, RegistrationOptions, RegistrationResult


def register(
    source: Clouds,
    target: Clouds,
    options: RegistrationOptions | Sequence[RegistrationOptions] | None = None,
    *,
    seed: int = 0,
) -> RegistrationResult:
    """Find the rigid transform of every pair, without a first guess.

    The paper's procedure (section 3.2): downsample, normals, FPFH, color histograms, fusion, mutual matches,
    RANSAC; then a refit to the inliers.

    Args:
        source: B clouds.
        target: B clouds.
        options: in meters, for all pairs or one per pair (which then differ in lengths only); ``None`` derives
            them from the spacing of each pair's points (``derive_options``); ``PAPER`` has the paper's.
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
    watch = Stopwatch()
    given_source, given_target, refused = source, target, refuse(source, target)
    source, target = set_aside(source, refused), set_aside(target, refused)
    per_pair = _options_of_pairs(source, target, options)
    watch.lap("options")

    source, target = downsample(source, per_pair), downsample(target, per_pair)
    watch.lap("downsample")
    source, source_near = oriented(source, per_pair)
    target, target_near = oriented(target, per_pair)
    watch.lap("neighbors and normals")
    source_color, target_color = color_of_pairs(source, target, per_pair)
    source_features = describe(source, source_near, per_pair, source_color)
    target_features = describe(target, target_near, per_pair, target_color)
    watch.lap("descriptors")
    matches = match_mutual(source_features, target_features, ratio=per_pair[0].ratio)
    watch.lap("matching")
    generator = torch.Generator().manual_seed(seed)
    result = ransac(source, target, matches, [option.ransac for option in per_pair], generator=generator)
    watch.lap("ransac")

    return replace(
        result,
        reason=tuple(early or late for early, late in zip(refused, result.reason, strict=True)),
        options=per_pair,
        notes=notes_on(given_source, given_target, per_pair),
        seconds=watch.laps(),
    )


def _options_of_pairs(
    source: Clouds, target: Clouds, options: RegistrationOptions | Sequence[RegistrationOptions] | None
) -> tuple[RegistrationOptions, ...]:
    if options is None:
        return derive_options(source, target)
    if isinstance(options, RegistrationOptions):
        return (options,) * len(source)
    listed = isinstance(options, Sequence) and all(isinstance(option, RegistrationOptions) for option in options)
    expect(listed, "options", "RegistrationOptions, one per pair or one for all", options)
    per_pair = tuple(options)
    expect(len(per_pair) == len(source), "options", f"one for all or one per pair ({len(source)})", len(per_pair))
    for option in per_pair[1:]:
        alike = without_lengths(option) == without_lengths(per_pair[0])
        expect(alike, "options", "options that differ in lengths only within one batch", option)
    return per_pair
