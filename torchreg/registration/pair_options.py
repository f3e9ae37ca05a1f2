"""The options of every pair, from what a call says and what the clouds are like."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from torchreg.errors import expect
from torchreg.registration.describe import expect_alike
from torchreg.registration.recipes import coarser
from torchreg.registration.same_clouds import same_clouds
from torchreg.registration.scale import derive_numbered
from torchreg.types import Clouds, RegistrationOptions


def options_of_pairs(
    source: Clouds,
    target: Clouds,
    options: RegistrationOptions | Sequence[RegistrationOptions] | None,
    effort: str | None,
    solver: str | None,
    numbers: Sequence[Sequence[int]] | None = None,
) -> tuple[RegistrationOptions, ...]:
    """One per pair; derived from the clouds' scale for ``None``, with another effort or solver where one is named.

    ``numbers`` are those of ``same_clouds``, where they are known already.

    Raises:
        ValueError: another type or number, or options that differ in more than lengths.
    """
    if options is None:
        per_pair = derive_numbered(source, target, same_clouds([source, target]) if numbers is None else numbers)
    elif isinstance(options, RegistrationOptions):
        per_pair = (options,) * len(source)
    else:
        listed = isinstance(options, Sequence) and all(isinstance(option, RegistrationOptions) for option in options)
        expect(listed, "options", "RegistrationOptions, one per pair or one for all", options)
        per_pair = tuple(options)
        expect(len(per_pair) == len(source), "options", f"one for all or one per pair ({len(source)})", len(per_pair))
    per_pair = tuple(changed(option, effort, solver) for option in per_pair)
    expect_alike(per_pair)
    return per_pair


def changed(options: RegistrationOptions, effort: str | None, solver: str | None) -> RegistrationOptions:
    """The options at another effort and with another solver; those of a fast run keep their lengths.

    So a run can be repeated by the options that its result holds.
    """
    if effort is not None:
        slower = replace(options, effort=effort)
        options = coarser(slower) if effort == "fast" and options.effort != "fast" else slower
    return options if solver is None else replace(options, solver=solver)
