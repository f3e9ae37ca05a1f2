"""The fit of the verdict's weights to the candidates of many cases, and its judgment of cases that it does not know.

A conditional logit by maximum likelihood, held by a ridge to weights that were set by hand. A case without a right
candidate is a case for none of them.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.verification.model import TERMS, Evidence, combined, probabilities, term_values
from torchreg.verification.reasons import MARGIN, accepted, least_margin

RIDGE = 3.0

CONTROLS = ("asymmetric_colors_two_stations", "easy_room", "object_far_viewpoint_guess")
"""Kinds of made pairs that are to be found."""

MADE_TO_FIT = (*CONTROLS, "other_rooms", "facade_ends")
"""Kinds of made pairs that weights are fitted to."""


class CaseCandidates(NamedTuple):
    """The candidates of one case: their evidence, the surprise of their matches (H,), and which are right (H,)."""

    name: str
    kind: str
    scenes: tuple[str, ...]
    evidence: Evidence
    surprise: Tensor
    right: Tensor
    refusal: str  # the kind of failure, where no rigid pose can be right; else empty


class CaseTerms(NamedTuple):
    """The candidates of one case: their terms (H, D) and which of them are right (H,)."""

    name: str
    kind: str
    scenes: tuple[str, ...]
    terms: Tensor
    right: Tensor
    refusal: str
    margin: float  # the least log-odds of a success over its runner-up


def terms_of(case: CaseCandidates) -> CaseTerms:
    terms = term_values(case.evidence, case.surprise)
    margin = least_margin(case.evidence) if len(case.right) > 0 else MARGIN
    return CaseTerms(case.name, case.kind, case.scenes, terms, case.right, case.refusal, margin)


def fit(seen: list[CaseTerms]) -> Tensor:
    """Weights (D,) by maximum likelihood, held to the prior by the ridge."""
    prior = torch.tensor([term.prior for term in TERMS.values()], dtype=torch.float64)
    most = max(len(case.terms) for case in seen)
    numbers = torch.zeros(len(seen), most, len(prior), dtype=torch.float64)
    legal, right = torch.zeros(2, len(seen), most, dtype=torch.bool)
    for row, case in enumerate(seen):
        numbers[row, : len(case.terms)], right[row, : len(case.terms)] = case.terms, case.right
        legal[row, : len(case.terms)] = True
    none = torch.zeros(len(seen), 1, dtype=torch.float64)
    weights = prior.clone().requires_grad_()
    optimizer = torch.optim.LBFGS([weights], max_iter=500, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimizer.zero_grad()
        odds = torch.where(legal, combined(numbers, weights), -1e30)
        every = torch.logsumexp(torch.cat([odds, none], dim=1), dim=1)
        # a case without a right candidate is a case for none of them
        truth = torch.where(right.any(dim=1), torch.logsumexp(torch.where(right, odds, -1e30), dim=1), none[:, 0])
        value = (every - truth).sum() + RIDGE * (weights - prior)[1:].square().sum()
        value.backward()
        return value

    optimizer.step(loss)
    return weights.detach()


class Judged(NamedTuple):
    """One case under weights: the winner's probability, whether it is right, and whether it is called a success."""

    name: str
    kind: str
    scenes: tuple[str, ...]
    probability: float
    right: bool
    success: bool


def judge(case: CaseTerms, weights: Tensor) -> Judged:
    if len(case.terms) == 0:
        return Judged(*case[:3], 0.0, False, False)
    odds, order = combined(case.terms, weights).sort(descending=True)
    probability = 0.0 if case.refusal else float(probabilities(odds)[0])
    return Judged(*case[:3], probability, bool(case.right[order[0]]), accepted(probability, odds, case.margin))


def fitted_to(case: CaseTerms) -> bool:
    """Whether weights are fitted to a case: not to places that equal themselves, nor to impostors.

    There, what looks right is right in all that the terms can see; ``LOOK_ALIKE`` and the margins are for them.
    """
    return case.kind != "made" or case.scenes[0] in MADE_TO_FIT


def cross_validated(seen: list[CaseTerms]) -> list[Judged]:
    """Every case judged by weights that know none of its scenes."""
    judged = []
    for scenes in dict.fromkeys(case.scenes for case in seen):
        weights = fit([case for case in seen if fitted_to(case) and not set(case.scenes) & set(scenes)])
        judged += [judge(case, weights) for case in seen if case.scenes == scenes]
    return judged
