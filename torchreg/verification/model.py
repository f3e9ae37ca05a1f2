"""From evidence to log-odds, and from the log-odds of all candidates to probabilities.

At most one of the distinct candidates of a pair is right, and perhaps none. With log-odds s_i of each against "none",

    P(i) = exp(s_i) / (1 + sum_j exp(s_j)),

a conditional logit with an outside option (McFadden, 1974). So two poses that the clouds support alike share the
probability between them, and neither comes out as certain. The log-odds follow from a few terms of the evidence
(``combined``); their weights are in weights.json beside this file, with the data and the method of the fit.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

LOOK_ALIKE = 0.08
"""The share of wrong poses that fit as well as right ones, in shape alone; set with the made pairs in view."""

_BY_CHANCE = 0.5
"""Less than the closeness of partners whose distance is left to chance, which is about 2/3."""

WEIGHTS = Path(__file__).with_name("weights.json")


class Term(NamedTuple):
    """One term of the log-odds."""

    weight: float  # as fitted
    typical: float  # its mean over right poses (of those that have colors, viewpoints)
    prior: float  # the weight set by hand that the fit starts from and stays near
    low: float | None = None  # the evidence counts as at least this much; ``None``: unbounded
    high: float | None = None  # and as at most this: beyond an overlap of 0.3, say, a pose is not more likely
    direct: bool = False  # whether it counts in full, however well the shapes fit (``combined``)


class Evidence(NamedTuple):
    """The evidence of the clouds themselves for H poses, (H,) float64 each.

    Attributes:
        overlap: share of points with a partner nearer than the threshold, the mean over both directions.
        closeness: mean over those partners of 1 - (distance / threshold)^2; 0 where there are none.
        normals: mean cosine between the normals of partners, its size alone where their sides are not sure; NaN
            without normals or partners.
        colors: correlation of the colors of partners; NaN without colors.
        strength: how evenly the surfaces of partners hold the pose (``information.strengths``); 0 for one plane.
        conflict: of the points at or before a surface that the other scanner saw, the share before it, in free
            space; NaN without known viewpoints.
        misses: of the points near the other scan, within a few thresholds, the share without a partner.
        features: concordance of the descriptors of geometry of partners (``evidence``); NaN without such.
        color_features: concordance of the descriptors of color of partners; NaN without such.
    """

    overlap: Tensor
    closeness: Tensor
    normals: Tensor
    colors: Tensor
    strength: Tensor
    conflict: Tensor
    misses: Tensor
    features: Tensor
    color_features: Tensor

    def take(self, rows: Tensor | slice) -> Evidence:
        """The poses ``rows`` (K,), in that order."""
        return Evidence(*(values[rows] for values in self))


def load_terms(path: Path = WEIGHTS) -> dict[str, Term]:
    """Read terms as ``save_terms`` wrote them; without a path, those shipped with the library."""
    return {name: Term(**numbers) for name, numbers in json.loads(path.read_text())["terms"].items()}


def save_terms(terms: Mapping[str, Term], provenance: Mapping[str, Any], path: Path = WEIGHTS) -> None:
    """Write terms, every float to its last bit, after their provenance."""
    written = {
        name: {field: value for field, value in term._asdict().items() if value is not None and value is not False}
        for name, term in terms.items()
    }
    path.write_text(json.dumps({**provenance, "terms": written}, indent=1) + "\n")


TERMS = load_terms()
"""The terms of the log-odds by name, in the order of the columns of ``term_values``."""


def term_values(evidence: Evidence, surprise: Tensor) -> Tensor:
    """The values (H, D) of ``TERMS`` for the evidence of H poses and the surprise (H,) of their matches."""

    def bounded(name: str, values: Tensor) -> Tensor:
        return values.clamp(TERMS[name].low, TERMS[name].high)

    columns = {
        "one": torch.ones_like(evidence.overlap),
        "overlap": torch.log(bounded("overlap", evidence.overlap)),
        "closeness": torch.log(bounded("closeness", evidence.closeness) - _BY_CHANCE),
        "normals": evidence.normals.nan_to_num(),
        "colors": torch.atanh(bounded("colors", evidence.colors.nan_to_num())),
        "colored": (~torch.isnan(evidence.colors)).double(),
        "strength": torch.log(bounded("strength", evidence.strength)),
        "conflict": torch.log1p(bounded("conflict", evidence.conflict.nan_to_num()) / 0.01),
        "seen": (~torch.isnan(evidence.conflict)).double(),
        "surprise": torch.log1p(bounded("surprise", surprise)),
        "misses": evidence.misses,
        "features": torch.atanh(bounded("features", evidence.features.nan_to_num())),
        "color_features": bounded("color_features", evidence.color_features.nan_to_num()),
    }
    return torch.stack([columns[name] for name in TERMS], dim=1)


def log_odds(evidence: Evidence, surprise: Tensor) -> Tensor:
    """(H,) log-odds of each pose against none being right."""
    weights = torch.tensor([term.weight for term in TERMS.values()], dtype=torch.float64, device=surprise.device)
    return combined(term_values(evidence, surprise), weights)


def combined(values: Tensor, weights: Tensor) -> Tensor:
    """Log-odds (..., H) of the values (..., H, D) of ``TERMS`` under weights (D,); gradients flow to the weights.

    Shape alone cannot make a pose certain: of wrong poses a share ``LOOK_ALIKE`` fits as well as the right one, where
    a place equals itself after a turn or another place. With s the log-odds of the shapes and c the direct terms,
    colors and free space, in which look-alikes differ,

        log-odds = c - log(exp(-s) + LOOK_ALIKE)
    """
    direct = torch.tensor([term.direct for term in TERMS.values()], device=values.device)
    shape = (values * torch.where(direct, 0.0, weights)).sum(dim=-1)
    other = (values * torch.where(direct, weights, 0.0)).sum(dim=-1)
    return other - torch.logaddexp(-shape, torch.full_like(shape, math.log(LOOK_ALIKE)))


def probabilities(odds: Tensor) -> Tensor:
    """(H,) of distinct poses with log-odds (H,)."""
    top = odds.amax().clamp(min=0) if len(odds) > 0 else odds.new_zeros(())
    weight = torch.exp(odds - top)
    return weight / (weight.sum() + torch.exp(-top))
