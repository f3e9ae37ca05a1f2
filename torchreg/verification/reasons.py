"""Why a pose is not trusted."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from torchreg.types import Failure
from torchreg.verification.model import MODEL, probability_alone, terms
from torchreg.verification.weigh import Weighed

ACCEPTED = 0.6
"""The least probability of a success, where points lie as dense as in the cases that the weights were fitted to."""

MARGIN = 1.0
"""The least log-odds of a success over its runner-up: about e to one."""

FIRM = 0.1
"""Strength below which a refused pose is said to slide; right poses of real pairs have 0.1 and more."""

_LAID_ON = 0.3  # overlap from which surfaces lie on each other, so that sliding is what is left to blame
_RIVAL = 0.05  # a rival with this share of the probability is named


def accepted(probability: float, odds: Tensor, least: float = ACCEPTED) -> bool:
    """Whether a best candidate of this probability is a success; ``odds`` (H,) of all candidates, best first."""
    return probability >= least and (len(odds) < 2 or float(odds[0] - odds[1]) >= MARGIN)


def refusal(
    found: Weighed, probabilities: list[float], strength: float, apart: Callable[[], str], least: float
) -> Failure | None:
    """Why the best candidate is refused; ``None`` where it is a success.

    Args:
        found: the H candidates of one pair, best first.
        probabilities: H of them.
        strength: of the best.
        apart: tells how far the runner-up is, in words; asked only where there is one.
        least: probability of a success.
    """
    probability, odds = probabilities[0], found.odds
    if accepted(probability, odds, least):
        return None
    figures = {"probability": probability, "least": least, "strength": strength}
    held = f"probability {probability:.2f} of being right, {least:g} is needed"
    if probability >= least:
        held = f"log-odds {float(odds[0] - odds[1]):.2f} above it, {MARGIN:g} are needed"
    rivals = len(probabilities) > 1
    if strength < FIRM and float(found.evidence.overlap[0]) >= _LAID_ON:
        others = f"; {apart()}, they agree nearly as well" if rivals else ""
        text = f"sliding: the surfaces leave a motion open (strength {strength:.3f}){others} ({held})"
        return Failure("sliding", text, figures)
    if rivals and probabilities[1] >= _RIVAL and float(probability_alone(odds[0])) >= least:
        return Failure("ambiguous", f"ambiguous: a second pose {apart()} agrees nearly as well ({held})", figures)
    kind, text = _weakest(found.take(slice(1)))
    return Failure(kind, f"{text} ({held})", figures)


def _weakest(one: Weighed) -> tuple[str, str]:
    """The kind and the words of what the best candidate (H = 1) lacks most, against what right poses have."""
    seen = one.evidence
    numbers: Tensor = terms(seen, one.surprise)[0]
    lack = {
        name: weight * (typical - value)
        for (name, (weight, typical)), value in zip(MODEL.items(), numbers.tolist(), strict=True)
    }
    if bool(torch.isnan(seen.colors[0])):
        lack["colors"] = 0.0
    if bool(torch.isnan(seen.conflict[0])):
        lack["conflict"] = 0.0
    overlap, closeness, normals, colors, strength, conflict = (float(value[0]) for value in seen)
    words = {
        "overlap": ("little overlap", f"too little overlap: {overlap:.0%} of the points find a partner"),
        "closeness": (
            "surfaces disagree",
            f"surfaces disagree: partners are {(1 - closeness) ** 0.5:.2f} thresholds apart",
        ),
        "normals": ("surfaces disagree", f"surfaces disagree: normals of partners have a mean cosine of {normals:.2f}"),
        "colors": ("colors disagree", f"colors disagree: those of partners correlate by {colors:.2f}"),
        "strength": ("sliding", f"sliding: the surfaces of partners leave a motion open (strength {strength:.3f})"),
        "conflict": (
            "free-space conflict",
            f"free-space conflict: {conflict:.1%} of the points stand where a scanner saw none",
        ),
        "surprise": ("no consensus", f"no consensus: {int(one.support[0])} matches agree, in few places"),
    }
    return words[max(words, key=lambda name: lack[name])]
