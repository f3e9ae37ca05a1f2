"""Why a pose is not trusted, as a ``Failure``: its kind, a sentence, and the figures behind it."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.metrics.pose import rre
from torchreg.solvers.poses import pose_vectors
from torchreg.types import Failure
from torchreg.verification.candidates import Candidates, Poses
from torchreg.verification.model import TERMS, Evidence, term_values

ACCEPTED = 0.6
"""The least probability of a success, where points lie as dense as in the cases that the weights were fitted to."""

MARGIN, MARGIN_BY_SHAPE = 1.0, 2.0
"""The least log-odds of a success over its runner-up: about e to one; without colors, by which rivals of the same shape
differ, 7 to one."""

FIRM_STRENGTH = 0.1
"""Strength below which sliding is the reason of a refused pose; right poses of real pairs have 0.1 and more."""

_SLIDING_OVERLAP = 0.3  # overlap from which surfaces lie on each other, so that sliding is the likely reason
_LIKELY = 0.01  # below this share two decimals do not tell a probability
_RIVAL = 0.05  # a rival with this share of the probability is named

_LACKING = {
    "overlap": ("little overlap", "too little overlap: {overlap:.0%} of the points find a partner"),
    "closeness": ("surfaces disagree", "surfaces disagree: partners are {thresholds_apart:.2f} thresholds apart"),
    "normals": ("surfaces disagree", "surfaces disagree: normals of partners have a mean cosine of {normals:.2f}"),
    "colors": ("colors disagree", "colors disagree: those of partners correlate by {colors:.2f}"),
    "misses": ("surfaces disagree", "surfaces disagree: {misses:.0%} of the points near the other scan miss it"),
    "features": ("surfaces disagree", "surfaces disagree: the descriptors of partners agree by {features:.2f} only"),
    "strength": ("sliding", "sliding: the surfaces of partners leave a motion open (strength {strength:.3f})"),
    "conflict": (
        "free-space conflict",
        "free-space conflict: {conflict:.1%} of the points stand where a scanner saw none",
    ),
    "surprise": ("no consensus", "no consensus: {support} matches agree, in few places"),
}
"""By the term of the log-odds that a pose lacks most: the failure's kind and its sentence, over the figures."""


class Displacement(NamedTuple):
    """How far apart two poses put the points of the source."""

    meters: float  # root mean square over the points
    degrees: float  # angle of the turn between the poses


def accepted(probability: float, odds: Tensor, margin: float, least: float = ACCEPTED) -> bool:
    """Whether a best candidate of this probability is a success.

    ``odds`` (H,) are those of all candidates, best first, ``margin`` is the least between the first two.
    """
    return probability >= least and (len(odds) < 2 or float(odds[0] - odds[1]) >= margin)


def least_margin(evidence: Evidence) -> float:
    """The least log-odds of a success over its runner-up, by what the evidence of the candidates of a pair holds."""
    return MARGIN_BY_SHAPE if bool(torch.isnan(evidence.colors).all()) else MARGIN


def failure_of(
    candidates: Candidates, probabilities: list[float], strength: float, points: Tensor, least: float
) -> Failure | None:
    """Why the best of H candidates of one pair, best first, is refused; ``None`` where it is a success.

    ``strength`` is that of the best, ``points`` (P, 3) are those of the source, from which the distance to the
    runner-up follows, ``least`` is the probability of a success.
    """
    probability, odds = probabilities[0], candidates.odds
    enough = least_margin(candidates.evidence)
    if accepted(probability, odds, enough, least):
        return None
    figures = {"probability": probability, "least": least}
    stated = round(probability, 2)
    if stated >= least > probability:  # rounded up it would read as enough
        stated = math.floor(100 * probability) / 100
    likely = f"{stated:.2f}" if stated >= _LIKELY else f"{probability:.1g}"  # 0.00 would read as impossible
    needed = f"probability {likely} of being right, {least:g} is needed"
    rival = ""
    if len(probabilities) > 1:
        meters, degrees = displacement(candidates.poses, points)
        rival = f"{meters:.3g} m and {degrees:.3g} degrees away"
        margin = float(odds[0] - odds[1])
        figures |= {"margin": margin, "rival_meters": meters, "rival_degrees": degrees}
        if probability >= least:
            needed = f"log-odds {margin:.2f} above it, {enough:g} are needed"
    if strength < FIRM_STRENGTH and float(candidates.evidence.overlap[0]) >= _SLIDING_OVERLAP:
        others = f"; {rival}, they agree nearly as well" if rival else ""
        text = f"sliding: the surfaces leave a motion open (strength {strength:.3f}){others} ({needed})"
        return Failure("sliding", text, {**figures, "strength": strength})
    if rival and probabilities[1] >= _RIVAL and float(torch.sigmoid(odds[0])) >= least:  # it alone is to blame
        text = f"ambiguous: a second pose {rival} agrees nearly as well ({needed})"
        return Failure("ambiguous", text, {**figures, "strength": strength})
    shown = {name: float(values[0]) for name, values in candidates.evidence._asdict().items()}
    shown |= {"thresholds_apart": (1 - shown["closeness"]) ** 0.5, "support": int(candidates.support[0])}
    kind, text = _LACKING[_most_lacking(candidates)]
    return Failure(kind, f"{text.format(**shown)} ({needed})", {**figures, **shown})


def _most_lacking(candidates: Candidates) -> str:
    """The term by which the best candidate falls short the most of right poses."""
    best = candidates.take(slice(1))
    values = dict(zip(TERMS, term_values(best.evidence, best.surprise)[0].tolist(), strict=True))
    lack = {name: TERMS[name].weight * (TERMS[name].typical - values[name]) for name in _LACKING}
    for name in ("colors", "conflict", "features"):
        if bool(torch.isnan(getattr(best.evidence, name)[0])):
            lack[name] = 0.0
    return max(lack, key=lambda name: lack[name])


def displacement(poses: Poses, points: Tensor) -> Displacement:
    """From the first of some poses to the second, over the points (P, 3) of the source."""
    two = poses.take(slice(2))
    vectors = pose_vectors(two.rotation.permute(1, 2, 0), two.translation.t(), points.double().t())
    return Displacement(float((vectors[:, 1] - vectors[:, 0]).square().sum().sqrt()), float(rre(*two.matrices())))
