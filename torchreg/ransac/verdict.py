"""Whether the agreement of the winner is more than chance gives.

The a-contrario test of Moisan and Stival (IJCV 57(3), 2004, doi:10.1023/B:VISI.0000013094.38752.54): were the
matches unrelated to the transform, each would be an inlier with a probability q. The expected number of
hypotheses with as many inliers as the winner, the number of false alarms, is then

    NFA = scored hypotheses x P(Binomial(M - s, q) >= inliers - s)

for M matches and samples of s (which fit by construction). q is measured on the pair itself: how often a match's
source point falls near some *other* match's target point under the transform.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchreg.geometry.chunks import row_chunks

LOG10_FALSE_ALARMS = -6.0
"""The most that is accepted. Neighboring points match neighboring points, so matches agree more than
independent ones would; that is what the distance from 0 allows for."""

_SAMPLE = 2000
_TERMS = 500


def refusal(support: int, sample_size: int, scored: int, source: Tensor, target: Tensor, threshold: float) -> str:
    """Why the winner may not be called a success, or an empty text.

    Args:
        support: inliers of the winner.
        sample_size: correspondences of a minimal sample.
        scored: hypotheses that were scored.
        source: (M, 3) matched points under the transform, meters, float64.
        target: (M, 3).
        threshold: meters, of an inlier.
    """
    count = len(source)
    chance = chance_rate(source, target, threshold)
    alarms = math.log10(max(1, scored)) + log10_binomial_tail(count - sample_size, support - sample_size, chance)
    if alarms <= LOG10_FALSE_ALARMS:
        return ""
    return (
        f"no consensus: {support} of {count} matches agree, too few to tell from chance "
        f"(10^{alarms:.1f} expected by chance, at most 10^{LOG10_FALSE_ALARMS:.0f} is accepted)"
    )


def chance_rate(source: Tensor, target: Tensor, threshold: float) -> float:
    """The share of pairs of different matches whose source (M, 3) and target (M, 3) lie within the threshold.

    At least one pair is assumed, so that the rate is never 0. Of more than 2,000 matches an even choice is taken.
    """
    step = max(1, -(-len(source) // _SAMPLE))
    p, q = source[::step].t(), target[::step].t()  # (3, m)
    size = p.shape[1]
    near = 0
    for rows in row_chunks(size, size):
        square = torch.zeros(rows.stop - rows.start, size, dtype=p.dtype, device=p.device)
        for i in range(3):
            difference = p[i, rows, None] - q[i]
            square += difference * difference
        inside = square < threshold * threshold
        inside.diagonal(rows.start).fill_(False)
        near += int(inside.sum())
    return max(near, 1) / max(size * (size - 1), 2)


def log10_binomial_tail(trials: int, successes: int, probability: float) -> float:
    """log10 P(Binomial(trials, probability) >= successes)."""
    if successes <= 0:
        return 0.0
    if successes > trials or probability >= 1:
        return -math.inf if successes > trials else 0.0
    if probability * trials >= successes:
        return 0.0  # no rarer than the mean
    log_p, log_q = math.log(probability), math.log1p(-probability)
    terms = [
        math.lgamma(trials + 1) - math.lgamma(k + 1) - math.lgamma(trials - k + 1) + k * log_p + (trials - k) * log_q
        for k in range(successes, min(trials, successes + _TERMS) + 1)
    ]
    largest = max(terms)
    return (largest + math.log(sum(math.exp(term - largest) for term in terms))) / math.log(10)
