"""Why a pose is not trusted: a name, a colon, and the figures behind it."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.verification.choose import Chosen
from torchreg.verification.model import MODEL, probability_alone, terms

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


def refusal(chosen: Chosen, apart: str, least: float) -> str:
    """Why the best candidate is refused, or an empty text.

    Args:
        chosen: the candidates of one pair.
        apart: how far the runner-up is, in words.
        least: probability of a success.
    """
    best, probability = chosen.candidates, float(chosen.probability[0])
    if accepted(probability, best.odds, least):
        return ""
    held = f"probability {probability:.2f} of being right, {least:g} is needed"
    if probability >= least:
        held = f"log-odds {float(best.odds[0] - best.odds[1]):.2f} above it, {MARGIN:g} are needed"
    if chosen.slide.strength < FIRM and float(best.evidence.overlap[0]) >= _LAID_ON:
        others = f"; {apart}, they agree nearly as well" if apart else ""
        return f"sliding: the surfaces leave a motion open (strength {chosen.slide.strength:.3f}){others} ({held})"
    if len(chosen.probability) > 1:
        alone, rival = float(probability_alone(best.odds[0])), float(chosen.probability[1])
        if alone >= least and rival >= _RIVAL:
            return f"ambiguous: a second pose {apart} agrees nearly as well ({held})"
    return f"{_weakest(chosen)} ({held})"


def _weakest(chosen: Chosen) -> str:
    """What the best candidate lacks most, against what right poses have."""
    one = chosen.candidates.take(torch.zeros(1, dtype=torch.int64, device=chosen.probability.device))
    seen, surprise = one.evidence, one.surprise
    numbers: Tensor = terms(seen, surprise)[0]
    lack = {
        name: weight * (typical - float(value))
        for (name, (weight, typical)), value in zip(MODEL.items(), numbers, strict=True)
    }
    if bool(torch.isnan(seen.colors[0])):
        lack["colors"] = 0.0
    if bool(torch.isnan(seen.conflict[0])):
        lack["conflict"] = 0.0
    words = {
        "overlap": f"too little overlap: {float(seen.overlap[0]):.0%} of the points find a partner",
        "closeness": f"surfaces disagree: partners are {(1 - float(seen.closeness[0])) ** 0.5:.2f} thresholds apart",
        "normals": f"surfaces disagree: normals of partners have a mean cosine of {float(seen.normals[0]):.2f}",
        "colors": f"colors disagree: those of partners correlate by {float(seen.colors[0]):.2f}",
        "strength": f"sliding: the surfaces of partners leave a motion open (strength {float(seen.strength[0]):.3f})",
        "conflict": f"free-space conflict: {float(seen.conflict[0]):.1%} of the points stand where a scanner saw none",
        "surprise": f"no consensus: {int(one.support[0])} matches agree, in few places",
    }
    return words[max(words, key=lambda name: lack[name])]
