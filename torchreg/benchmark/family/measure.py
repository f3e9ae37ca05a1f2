"""One fusion on one pair: its matches, the pose by matches alone, and the pose that ``register`` returns."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from torch import Tensor

from torchreg import metrics
from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.family.fusions import Fusion
from torchreg.benchmark.family.pairs import FamilyPair, ThinPair, thin_pair
from torchreg.benchmark.field.summary import MATCH_VOXELS
from torchreg.registration import RegistrationOptions, describe_clouds, register_described
from torchreg.types import RegistrationResult

NO_ANSWER: Row = {
    **dict.fromkeys(("dimensions", "bytes", "describe_s", "match_s", "seconds")),
    **{"matches": 0, "inlier_ratio": 0.0, "success": False, "probability": 0.0},
    **dict.fromkeys(("rre_deg", "rte_m", "plain_rre_deg", "plain_rte_m")),
}
"""The figures of a fusion that ended with an error, which has found nothing."""


class Measurement:
    """Measures fusions on the pairs of a study.

    The clouds of one pair are kept until the next, and what two fusions do alike (where there are no colors) is done
    once.

    Args:
        pairs: of the study.
        points: as of ``thin_pair``.
        seed: of every random draw.
    """

    def __init__(self, pairs: Sequence[FamilyPair], *, points: int | None, seed: int) -> None:
        self._pairs, self._points, self._seed = pairs, points, seed
        self._at: tuple[int, ThinPair] | None = None
        self._done: dict[RegistrationOptions, Row] = {}

    def row(self, number: int, fusion: Fusion) -> Row:
        """The row, without its key, of a fusion on the pair of a number."""
        member, thin = self._pairs[number], self._thin(number)
        pair = member.pair
        return {
            "list": member.of_list,
            "scene": pair.scene,
            "pair": pair.name,
            "overlap": pair.overlap,
            "colored": thin.colored,
            "voxel_m": pair.voxel,
            "edge_m": thin.edge,
            "points": [len(thin.source.points), len(thin.target.points)],
            "fusion": fusion.name,
            **self._figures(thin, fusion, pair.T_target_source),
        }

    def _figures(self, thin: ThinPair, fusion: Fusion, T_true: Tensor) -> Row:
        if not fusion.fits(colored=thin.colored):
            return {**NO_ANSWER, "error": "no colors, where the list says that there are"}
        options = fusion.options(thin.edge, colored=thin.colored)
        if options not in self._done:
            self._done[options] = _figures(thin, options, T_true, self._seed)
        return self._done[options]

    def _thin(self, number: int) -> ThinPair:
        if self._at is None or self._at[0] != number:
            self._at = (number, thin_pair(self._pairs[number].pair, self._points))
            self._done.clear()
        return self._at[1]


def _figures(thin: ThinPair, options: RegistrationOptions, T_true: Tensor, seed: int) -> Row:
    try:
        return {**_described_figures(thin, options, T_true, seed), "error": ""}
    except Exception as problem:  # a descriptor that fails has not found the pair
        return {**NO_ANSWER, "error": f"{type(problem).__name__}: {problem}"}


def _described_figures(thin: ThinPair, options: RegistrationOptions, T_true: Tensor, seed: int) -> dict[str, Any]:
    """Describe both clouds once, then register them by matches alone and by all that ``register`` does.

    Returns:
        dimensions of a feature, bytes of all features, matches (mutual), inlier_ratio; plain_rre_deg and plain_rte_m of
        the pose that most matches agree on; rre_deg, rte_m, success and probability of the pose that clouds decide on;
        processor seconds, which a busy machine changes least: describe_s (neighborhoods, normals and descriptors of
        both clouds), match_s (mutual matches and their pose), and seconds (from the thinned clouds to the pose that
        clouds decide on).
    """
    begin = time.process_time()
    source, target = (describe_clouds(cloud, options) for cloud in (thin.source, thin.target))
    described = time.process_time()
    decided = register_described(source, target, [options], seed=seed)
    registered = time.process_time()
    plain = register_described(source, target, [replace(options, effort="plain")], seed=seed)
    matched = time.process_time()
    values = [features.values for side in (source, target) for features in side.features]
    near = MATCH_VOXELS * thin.edge
    ratio = metrics.inlier_ratio(plain.source, plain.target, plain.correspondences, T_true[None], near)
    return {
        "dimensions": sum(features.values.shape[1] for features in source.features),
        "bytes": sum(each.numel() * each.element_size() for each in values),
        "describe_s": described - begin,
        "match_s": matched - registered,
        "seconds": registered - begin,
        "matches": len(plain.correspondences.source),
        "inlier_ratio": float(ratio),
        **{f"plain_{name}": value for name, value in _errors(plain, T_true).items()},
        **_errors(decided, T_true),
        "success": bool(decided.success[0]),
        "probability": 0.0 if decided.probability is None else float(decided.probability[0]),
    }


def _errors(result: RegistrationResult, T_true: Tensor) -> dict[str, float | None]:
    """Degrees and meters; ``None`` where there is no pose."""
    T = result.T_target_source[0]
    if not bool(T.isfinite().all()):
        return {"rre_deg": None, "rte_m": None}
    return {"rre_deg": float(metrics.rre(T_true, T)), "rte_m": float(metrics.rte(T_true, T))}
