"""Whether more matches agree with the best pose than by chance.

The a-contrario test of Moisan and Stival (IJCV 57(3), 2004, doi:10.1023/B:VISI.0000013094.38752.54): were the
matches unrelated to the transform, each would come within a distance e with a probability q(e). The expected
number of hypotheses under which as many do, the number of false alarms, is then

    NFA(e) = tests x P(Binomial(M - s, q(e)) >= k(e) - s)

for M matches, k(e) of them within e, and samples of s (which fit by construction). ``tests`` counts the scored
hypotheses, at most one per distinct sample, and the distances e that are tried: the inlier threshold and finer
ones, since a tight agreement of few says as much as a loose one of many. q is measured on the pair itself: how
often a match's source point falls near some *other* match's target point under the transform; it is taken to
shrink with the square of e, as on surfaces.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.types import Failure

LOG10_FALSE_ALARMS = -12.0
"""The most that is accepted. It lies far below 0 since matches are not independent: neighboring points match
neighboring points, so they agree more often than independent ones would."""

_FINER = tuple(2 ** (-j / 2) for j in range(9))
_SAMPLE = 2000


def log10_false_alarms(source: Tensor, target: Tensor, threshold: float, *, sample_size: int, scored: float) -> float:
    """The expected number of hypotheses by chance that agree as well as this one, as a power of ten.

    ``source`` (M, 3), under the transform, and ``target`` (M, 3) are matched points, float64; no more of the ``scored``
    hypotheses count than there are samples of ``sample_size``.
    """
    count = len(source)
    chance = chance_rate(source, target, threshold)
    difference = (source - target).t()
    square = difference[0] * difference[0] + difference[1] * difference[1] + difference[2] * difference[2]
    limits = [scale * scale * threshold * threshold for scale in _FINER]
    tests = len(_FINER) * max(1, min(scored, math.comb(count, sample_size)))
    tails = [
        log10_binomial_tail(count - sample_size, int((square < limit).sum()) - sample_size, chance * scale * scale)
        for scale, limit in zip(_FINER, limits, strict=True)
    ]
    return math.log10(tests) + min(tails)


def no_consensus(support: int, matches: int, alarms: float) -> Failure | None:
    """Why a winner with so many inliers and false alarms (log10) is no success; ``None`` where it is one."""
    if alarms <= LOG10_FALSE_ALARMS:
        return None
    text = (
        f"no consensus: {support} of {matches} matches agree, too few to tell from chance "
        f"(10^{alarms:.1f} such agreements expected by chance, at most 10^{LOG10_FALSE_ALARMS:.0f} is accepted)"
    )
    figures = {"support": support, "matches": matches, "log10_false_alarms": alarms}
    return Failure("no consensus", text, figures)


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
    first = math.lgamma(trials + 1) - math.lgamma(successes + 1) - math.lgamma(trials - successes + 1)
    first += successes * log_p + (trials - successes) * log_q
    # beyond the mean every term is smaller than the one before, by a ratio that falls itself
    total, term, odds = 1.0, 1.0, probability / (1 - probability)
    for k in range(successes, trials):
        term *= (trials - k) / (k + 1) * odds
        total += term
        if term < 1e-17 * total:
            break
    return (first + math.log(total)) / math.log(10)
