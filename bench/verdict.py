"""How far the verdict can be trusted: fitted, cross-validated by scene, drawn as a reliability plot.

    python bench/verdict.py                 runs all cases (some minutes), then fits, validates and draws
    python bench/verdict.py --keep FILE     keeps the candidates of all cases there; used again where it exists
    python bench/verdict.py --ship          also writes the weights that come with the library

Every case of ``cases.py`` is registered by the default. The weights are those of a conditional logit over the
candidates of every case, by maximum likelihood, held by a ridge to weights that were set by hand. For the figures a
scene is left out in turn: the weights are fitted to the cases that have nothing to do with it and judged on the rest.
Written: bench/results/verdict.json, docs/verdict.png and docs/benchmarks/verdict.md; with ``--ship``
torchreg/verification/weights.json, rounded to two decimals, which every verdict from then on depends on.
"""

from __future__ import annotations

import pickle
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from datetime import date
from itertools import pairwise
from pathlib import Path
from typing import Any

import torch
from cases import Case, cases
from common import DOCS, bench_parser, in_words, listed_pairs, machine, publish, save, table
from torch import Tensor
from verdict_model import (
    CONTROLS,
    RIDGE,
    CaseCandidates,
    CaseTerms,
    Judged,
    cross_validated,
    fit,
    fitted_to,
    terms_of,
)

import torchreg as tr
from torchreg import metrics
from torchreg.verification.impostors import IMPOSTORS
from torchreg.verification.model import TERMS, Evidence, combined, save_terms
from torchreg.verification.reasons import ACCEPTED, MARGIN, MARGIN_BY_SHAPE

ROTATION_BOUND, TRANSLATION_VOXELS = 15.0, 6.0
WORKERS = 2


def candidates_of(case: Case) -> CaseCandidates:
    """Register one case, and keep its candidates."""
    result = tr.register(case.source, case.target)
    candidates, voxel = result.candidates[0], case.voxel
    if voxel is None:
        voxel = result.options[0].inlier_threshold / 1.5

    def column(name: str) -> Tensor:
        return torch.tensor([getattr(candidate, name) for candidate in candidates], dtype=torch.float64)

    right = torch.zeros(len(candidates), dtype=torch.bool)
    if case.truth is not None and candidates:
        T = torch.stack([candidate.T_target_source for candidate in candidates])
        right = metrics.rre(case.truth, T) < ROTATION_BOUND
        right &= metrics.rte(case.truth, T) < TRANSLATION_VOXELS * voxel
    failure = result.failure[0]
    refusal = failure.kind if failure is not None and failure.kind in IMPOSTORS else ""
    evidence = Evidence(*map(column, Evidence._fields))
    return CaseCandidates(case.name, case.kind, case.scenes, evidence, column("surprise"), right, refusal)


def share_of(part: int) -> list[CaseCandidates]:
    """Every ``WORKERS``-th case from ``part`` on."""
    torch.set_num_threads(1)
    return [candidates_of(case) for number, case in enumerate(cases()) if number % WORKERS == part]


def summary(judged: list[Judged], belongs: Callable[[Judged], bool]) -> dict[str, Any]:
    chosen = [case for case in judged if belongs(case)]
    right, wrong = [case for case in chosen if case.right], [case for case in chosen if not case.right]
    return {
        "cases": len(chosen),
        "right": len(right),
        "right_refused": sum(not case.success for case in right),
        "wrong": len(wrong),
        "wrong_called_success": sum(case.success for case in wrong),
    }


FIRST_SCENES = {pair["scene"] for pair in listed_pairs()}


def of_kind(kind: str) -> Callable[[Judged], bool]:
    return lambda case: case.kind == kind


def of_pairs(kind: str, *, first: bool) -> Callable[[Judged], bool]:
    """Pairs of the scenes that the library was made on, or of the others."""
    demos = ("geotransformer_demo", "3dmatch_single_depth")
    return lambda case: case.kind == kind and (case.scenes[0] in FIRST_SCENES and case.name not in demos) == first


GROUPS: dict[str, Callable[[Judged], bool]] = {
    "real pairs": of_pairs("pairs", first=True),
    "the same, viewpoints only assumed": of_pairs("assumed", first=True),
    "harder real pairs, of other scenes": of_pairs("pairs", first=False),
    "the same, viewpoints only assumed ": of_pairs("assumed", first=False),
    "real pairs, part of the source cut away": of_kind("cut"),
    "real pairs without colors": of_kind("gray"),
    "simulated halls and roads, same and different": of_kind("simulated"),
    "furnished rooms, same and different, without colors": of_kind("rooms"),
    "different scenes": of_kind("strangers"),
    "two ends of one cloud": of_kind("two ends"),
    "made to deceive": lambda case: case.kind == "made" and case.scenes[0] not in CONTROLS,
    "of them, places that equal themselves": lambda case: case.scenes[0].startswith("symmetric_"),
    "made as controls": lambda case: case.kind == "made" and case.scenes[0] in CONTROLS,
}


def ship(
    weights: Tensor, typical: Tensor, seen: list[CaseTerms], groups: dict[str, Any], facts: dict[str, Any]
) -> None:
    """Write the weights that come with the library, with where they come from."""
    terms = {
        name: term._replace(weight=round(weight, 2), typical=round(mean, 2))
        for (name, term), weight, mean in zip(TERMS.items(), weights.tolist(), typical.tolist(), strict=True)
    }
    provenance = {
        "content": "terms of the log-odds that a pose is right: weight times value, added up; read by "
        "torchreg/verification/model.py",
        "command": "python bench/verdict.py --ship",
        "fitted": {
            "how": "conditional logit over the candidates of every case, none of them being right one of its outcomes; "
            f'maximum likelihood, held to the priors by a ridge of {RIDGE:g} (all but "one"); rounded to two decimals',
            "cases": dict(Counter(case.kind for case in seen)),
            "effort": "balanced",
            "bounds": "of the evidence, set by hand",
            "commit": facts["commit"],
        },
        "validated": {
            "how": "every case judged by weights that were fitted without its scenes",
            "date": date.today().isoformat(),
            "machine": facts,
            "groups": groups,
        },
    }
    save_terms(terms, provenance)


def draw(judged: list[Judged], path: Path) -> None:
    """Share of right poses against stated probability, and how many poses each bin holds."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    edges = torch.tensor([0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0])
    p = torch.tensor([case.probability for case in judged])
    right = torch.tensor([case.right for case in judged]).double()
    figure, (above, below) = pyplot.subplots(
        2, 1, figsize=(5.2, 5.6), height_ratios=(3, 1), sharex=True, layout="constrained"
    )
    above.plot([0, 1], [0, 1], color="0.6", linewidth=1, label="as stated")
    for low, high in pairwise(edges):
        inside = (p >= low) & ((p < high) | (high == 1))
        count = int(inside.sum())
        if count == 0:
            continue
        share = float(right[inside].mean())
        spread = 1.96 * (max(share * (1 - share), 0.25 / count) / count) ** 0.5
        bars = [[min(spread, share)], [min(spread, 1 - share)]]
        above.errorbar(float(p[inside].mean()), share, yerr=bars, fmt="o", color="#0072b2", capsize=3)
    above.set_ylabel("share that is right")
    above.set_title("The verdict on scenes it was not fitted to", fontsize=11)
    above.legend(frameon=False)
    bins = torch.linspace(0, 1, 21).tolist()
    groups = [p[right == 0].tolist(), p[right == 1].tolist()]
    below.hist(groups, bins=bins, stacked=True, color=["#d55e00", "#009e73"], label=["wrong", "right"])
    below.set_yscale("symlog", linthresh=10)
    below.set_xlabel("stated probability")
    below.set_ylabel("poses")
    below.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=150)


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("--keep", type=Path, help="a file for the candidates of all cases")
    parser.add_argument("--ship", action="store_true", help="write the weights that come with the library")
    arguments = parser.parse_args()
    listed_pairs()
    if arguments.keep and arguments.keep.exists():
        kept = pickle.loads(arguments.keep.read_bytes())
    else:
        with ProcessPoolExecutor(WORKERS) as pool:
            kept = [case for part in pool.map(share_of, range(WORKERS)) for case in part]
        if arguments.keep:
            arguments.keep.write_bytes(pickle.dumps(kept))
    seen = [terms_of(case) for case in kept]
    fitted = [case for case in seen if fitted_to(case)]
    weights = fit(fitted)
    won = [case.terms[int(combined(case.terms, weights).argmax())] for case in seen if bool(case.right.any())]
    typical = torch.stack(won).mean(dim=0)
    shares = typical.clone()
    for name, known in (
        ("colors", "colored"),
        ("color_features", "colored"),
        ("conflict", "seen"),
    ):  # over those that have any
        place, flag = list(TERMS).index(name), list(TERMS).index(known)
        typical[place] /= shares[flag]
    typical[[list(TERMS).index("colored"), list(TERMS).index("seen")]] = 1.0
    judged = cross_validated(seen)
    groups = {name: summary(judged, belongs) for name, belongs in GROUPS.items()}
    facts = machine()
    save(
        "verdict",
        {
            "machine": facts,
            "weights": dict(zip(TERMS, weights.tolist(), strict=True)),
            "typical": dict(zip(TERMS, typical.tolist(), strict=True)),
            "least_probability": ACCEPTED,
            "least_margin": MARGIN,
            "least_margin_by_shape": MARGIN_BY_SHAPE,
            "groups": groups,
            "cases": [case._asdict() for case in judged],
        },
    )
    draw(judged, DOCS / "verdict.png")
    for name, weight, mean in zip(TERMS, weights.tolist(), typical.tolist(), strict=True):
        print(f"{name:10} {weight:6.2f} {mean:6.2f}")
    if arguments.ship:
        ship(weights, typical, fitted, groups, facts)
    head = ["pairs", "right", "of them refused", "wrong", "of them called a success"]
    rows = [
        [
            name,
            str(group["right"]),
            str(group["right_refused"]),
            str(group["wrong"]),
            str(group["wrong_called_success"]),
        ]
        for name, group in groups.items()
    ]
    text = f"{table(head, rows)}\n\n{in_words(facts)}."
    print(text)
    if not arguments.no_docs:
        publish("verdict", text)
    for case in judged:
        if case.right != case.success:
            print(
                "right, refused:" if case.right else "wrong, a success:",
                case.kind,
                case.name,
                f"{case.probability:.2f}",
            )


if __name__ == "__main__":
    main()
