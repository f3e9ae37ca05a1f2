"""Registration on keypoints beside that on all points, on the real pairs beside the checkout.

    python bench/keypoints.py              every rule and pair, at the efforts plain and balanced
    python bench/keypoints.py --pairs 6    the first so many pairs; the documents stay as they are
    python bench/keypoints.py --saved      the table from bench/results/keypoints.json, nothing measured

Options are derived from the spacing of each pair's points, rules from the same spacing. A pair is found where its pose
is within 15 degrees and 0.3 m of the truth. Writes bench/results/keypoints.json and docs/benchmarks/keypoints.md.
"""

from __future__ import annotations

import json
import time
from dataclasses import replace
from statistics import median
from typing import Any

import torch
from common import REAL, RESULTS, bench_parser, in_words, listed_pairs, machine, publish, save, table

import torchreg as tr
from torchreg.keypoints import KEYPOINTS
from torchreg.metrics import recalled_by_error
from torchreg.registration.spacing import NORMAL_SPACINGS

EFFORTS = ("plain", "balanced")
RULES = ("all points", *KEYPOINTS)


def measured(pair: dict[str, Any]) -> list[dict[str, Any]]:
    """One row per effort and rule."""
    source, target = (tr.read_cloud(REAL / pair[side], viewpoint="auto") for side in ("source", "target"))
    truth = torch.tensor(pair["T"], dtype=torch.float64)[None]
    rows = []
    for effort in EFFORTS:
        (derived,) = tr.derive_options(source, target, effort=effort)
        spacing = derived.normal_radius / NORMAL_SPACINGS
        for rule in RULES:
            keypoints = KEYPOINTS[rule].for_spacing(spacing) if rule in KEYPOINTS else None
            begin = time.perf_counter()
            result = tr.register(source, target, replace(derived, keypoints=keypoints))
            seconds = time.perf_counter() - begin
            found = bool(recalled_by_error(truth, result.T_target_source)[0])
            rows.append(
                {
                    "pair": pair["name"],
                    "effort": effort,
                    "rule": rule,
                    "found": found,
                    "success": bool(result.success[0]),
                    "matches": len(result.correspondences.source),
                    "seconds": seconds,
                    "stages": dict(result.seconds),
                }
            )
            print(rows[-1], flush=True)
    return rows


def row(rows: list[dict[str, Any]]) -> list[str]:
    """One effort and rule over all pairs."""
    right, wrong = ([one for one in rows if one["found"] == found] for found in (True, False))

    def stage(*names: str) -> str:
        return f"{median(sum(one['stages'].get(name, 0.0) for name in names) for one in rows):.2f} s"

    return [
        rows[0]["effort"],
        rows[0]["rule"],
        f"{len(right)} of {len(rows)}",
        str(sum(one["success"] for one in wrong)),
        str(sum(not one["success"] for one in right)),
        f"{median(one['matches'] for one in rows):,.0f}",
        stage("keypoints"),
        stage("matching", "hypotheses"),
        f"{median(one['seconds'] for one in rows):.2f} s",
    ]


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("--pairs", type=int, help="only the first so many pairs")
    parser.add_argument("--saved", action="store_true", help="write the table from saved results, nothing measured")
    arguments = parser.parse_args()
    if arguments.saved:
        saved = json.loads((RESULTS / "keypoints.json").read_text())
        facts, rows = saved["machine"], saved["rows"]
    else:
        facts, rows = machine(), [one for pair in listed_pairs()[: arguments.pairs] for one in measured(pair)]
    head = ["effort", "matched", "pairs found", "wrong, called right", "right, refused", "matches"]
    head += ["keypoints", "matching and hypotheses", "the whole"]
    groups = [(effort, rule) for effort in EFFORTS for rule in RULES]
    text = table(head, [row([one for one in rows if (one["effort"], one["rule"]) == group]) for group in groups])
    print(text)
    if arguments.pairs is None:
        save("keypoints", {"machine": facts, "rows": rows})
        if not arguments.no_docs:
            publish("keypoints", f"{text}\n\n{in_words(facts)}.")


if __name__ == "__main__":
    main()
