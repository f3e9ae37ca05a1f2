"""One fusion on one pair: its matches, the pose by matches alone, and the pose that ``register`` returns."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from torch import Tensor

from torchreg import metrics
from torchreg.benchmark.core.rows import Row
from torchreg.benchmark.family.fusions import FPFH, Fusion
from torchreg.benchmark.family.pairs import FamilyPair, ThinPair, thin_pair
from torchreg.benchmark.field.summary import MATCH_VOXELS
from torchreg.descriptors.descriptor import Descriptor
from torchreg.neighborhoods.search import neighbors
from torchreg.registration import DescribedClouds, RegistrationOptions, describe_clouds, register_described
from torchreg.registration.describe import description_of, features_of
from torchreg.types import Features, RegistrationResult

EFFORTS = ("plain", "balanced")
"""How poses are found: by matches alone, or also by all that ``register`` does by default."""

NO_ANSWER: Row = {
    **dict.fromkeys(("dimensions", "bytes", "describe_s", "match_s", "seconds")),
    **{"matches": 0, "inlier_ratio": 0.0, "success": False, "probability": 0.0},
    **dict.fromkeys(("rre_deg", "rte_m", "plain_rre_deg", "plain_rte_m")),
}
"""The figures of a fusion that ended with an error, which has found nothing."""


class Measurement:
    """Measures fusions on the pairs of a study.

    The clouds of one pair are kept until the next with what describes them, which several fusions share; what two
    fusions do alike (where there are no colors) is done once.

    Args:
        pairs: of the study.
        points: as of ``thin_pair``.
        effort: one of ``EFFORTS``.
        seed: of every random draw.
    """

    def __init__(self, pairs: Sequence[FamilyPair], *, points: int | None, effort: str, seed: int) -> None:
        self._pairs, self._points, self._effort, self._seed = pairs, points, effort, seed
        self._at: tuple[int, ThinPair] | None = None
        self._sides: tuple[_DescribedSide, ...] = ()
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
            try:
                figures = self._measured(options, T_true, MATCH_VOXELS * thin.edge)
                self._done[options] = {**figures, "error": ""}
            except Exception as problem:  # a descriptor that fails has not found the pair
                self._done[options] = {**NO_ANSWER, "error": f"{type(problem).__name__}: {problem}"}
        return self._done[options]

    def _measured(self, options: RegistrationOptions, T_true: Tensor, near: float) -> dict[str, Any]:
        """Register both clouds by matches alone, and by all that ``register`` does.

        Returns:
            dimensions of a feature, bytes of all features, matches (mutual), inlier_ratio (of those nearer than
            ``near``, meters, under the truth); plain_rre_deg and plain_rte_m of the pose that most matches agree on;
            rre_deg, rte_m, success and probability (``None`` for effort plain) of the pose that is returned; processor
            seconds, which a busy machine changes least: describe_s (the descriptors of both clouds), match_s (mutual
            matches and their pose), and seconds (both descriptions and the pose that is returned).
        """
        source, target = (side.described(options) for side in self._sides)
        describe_s = sum(side.features[record].seconds for side in self._sides for record in options.descriptors)
        begin = time.process_time()
        plain = register_described(source, target, [replace(options, effort="plain")], seed=self._seed)
        match_s = register_s = time.process_time() - begin
        answer = plain
        if self._effort != "plain":
            begin = time.process_time()
            answer = register_described(source, target, [options], seed=self._seed)
            register_s = time.process_time() - begin
        values = [features.values for side in (source, target) for features in side.features]
        ratio = metrics.inlier_ratio(plain.source, plain.target, plain.correspondences, T_true[None], near)
        return {
            "dimensions": sum(features.values.shape[1] for features in source.features),
            "bytes": sum(each.numel() * each.element_size() for each in values),
            "describe_s": describe_s,
            "match_s": match_s,
            "seconds": describe_s + register_s,
            "matches": len(plain.correspondences.source),
            "inlier_ratio": float(ratio),
            **{f"plain_{name}": value for name, value in _errors(plain, T_true).items()},
            **_errors(answer, T_true),
            "success": bool(answer.success[0]),
            "probability": None if answer.probability is None else float(answer.probability[0]),
        }

    def _thin(self, number: int) -> ThinPair:
        if self._at is None or self._at[0] != number:
            thin = thin_pair(self._pairs[number].pair, self._points)
            usual = FPFH.options(thin.edge, colored=thin.colored)
            self._at = (number, thin)
            self._sides = tuple(_DescribedSide(describe_clouds(cloud, usual)) for cloud in (thin.source, thin.target))
            self._done.clear()
        return self._at[1]


class _TimedFeatures(NamedTuple):
    values: Features
    seconds: float  # of the processor, neighborhoods not counted


class _DescribedSide:
    """One cloud with normals, and its features by every descriptor that was asked for."""

    def __init__(self, base: DescribedClouds) -> None:
        self._base = base
        self.features: dict[Descriptor, _TimedFeatures] = {}

    def described(self, options: RegistrationOptions) -> DescribedClouds:
        """The cloud as ``describe_clouds`` describes it by these options."""
        cloud = self._base.cloud
        for record in options.descriptors:
            if record not in self.features:
                near = neighbors(cloud, record.radius, record.max_neighbors)
                begin = time.process_time()
                (features,) = features_of(cloud, near, [[record]])
                self.features[record] = _TimedFeatures(features, time.process_time() - begin)
        return replace(
            self._base,
            features=tuple(self.features[record].values for record in options.descriptors),
            descriptions=(description_of(options, colored=cloud.colors is not None),),
        )


def _errors(result: RegistrationResult, T_true: Tensor) -> dict[str, float | None]:
    """Degrees and meters; ``None`` where there is no pose."""
    T = result.T_target_source[0]
    if not bool(T.isfinite().all()):
        return {"rre_deg": None, "rte_m": None}
    return {"rre_deg": float(metrics.rre(T_true, T)), "rte_m": float(metrics.rte(T_true, T))}
