"""The paper's open questions: how many bins, how wide, how heavy, which channels; and whether learning beats the rule.

    python bench/sensitivity.py sweep      one choice varied at a time; table and chart (--per-scene 3: a quarter of it)
    python bench/sensitivity.py learn      weights trained on some scenes, judged on others
    python bench/sensitivity.py ship       train on all scenes and write the weights that tr.LEARNED reads

Pairs: the colored real ones and simulated malls, averaged over each pair's voxels v: normals 2 v / 30, FPFH 5 v / 100.
Inlier ratio: share of the mutual matches nearer than 2 v under the truth. Found: RANSAC over 100,000 hypotheses, inlier
threshold 1.5 v, ends within 15 degrees and 6 v of the truth. Measurements go to bench/results/sensitivity/ as they
come; a run that breaks off goes on from there.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from common import REAL, RESULTS, ROOT, in_words, machine, save
from readme import put_into_readme

from torchreg.benchmark.rows import Rows
from torchreg.benchmark.sensitivity.cases import real_cases, simulated_cases
from torchreg.benchmark.sensitivity.figures import draw_sweep
from torchreg.benchmark.sensitivity.learned import judged_by_others, learned_table, trained_model
from torchreg.benchmark.sensitivity.sweep import sweep, sweep_table
from torchreg.benchmark.sensitivity.variants import AXES, BETTER_RULE, PAPER_RULE, label
from torchreg.descriptors.learned import SHIPPED, save_weights
from torchreg.learning.prepared import PreparedPair
from torchreg.learning.training import TrainingOptions

KEPT = RESULTS / "sensitivity"
MALLS = range(4)
SEEDS = range(3)
OPTIONS = TrainingOptions()


def say(line: str) -> None:
    print(line, flush=True)


def run_sweep(pairs: Sequence[PreparedPair], kept: Rows) -> str:
    texts = []
    for title, center, picture in (
        ("Around the paper's rule", PAPER_RULE, "sensitivity"),
        ("Around hue, saturation and value, not equalized", BETTER_RULE, "sensitivity_better"),
    ):
        found = sweep(pairs, center, kept, report=say)
        chosen = {axis: label(getattr(center, axis)) for axis in AXES}
        draw_sweep(pairs, found, chosen, ROOT / "docs" / f"{picture}.png")
        texts.append(f"{title}, {len(pairs)} pairs:\n\n{sweep_table(found, center)}")
    return "\n\n".join(texts)


def run_learn(pairs: Sequence[PreparedPair], kept: Rows) -> str:
    found = judged_by_others(pairs, SEEDS, OPTIONS, kept, report=say)
    return learned_table(pairs, found)


def spread_evenly(pairs: Sequence[PreparedPair], most: int) -> list[PreparedPair]:
    chosen = []
    for scene in dict.fromkeys(pair.scene for pair in pairs):
        own = [pair for pair in pairs if pair.scene == scene]
        step = max(1, len(own) // most)
        chosen += own[::step][:most]
    return chosen


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", choices=("sweep", "learn", "ship"))
    parser.add_argument("--per-scene", type=int, help="so many pairs of every scene, spread evenly over its list")
    parser.add_argument("--no-readme", action="store_true", help="leave README.md as it is")
    arguments = parser.parse_args()
    if not REAL.exists():
        raise SystemExit(f"the real pairs are not there: {REAL.relative_to(ROOT.parent)} beside the checkout")
    pairs = [*real_cases(REAL), *simulated_cases(MALLS)]
    if arguments.per_scene is not None:
        pairs = spread_evenly(pairs, arguments.per_scene)
    if arguments.study == "ship":
        say(f"weights in {save_weights(trained_model(pairs, OPTIONS), SHIPPED)}")
        return
    KEPT.mkdir(parents=True, exist_ok=True)
    kept = Rows(KEPT, {"study": "sensitivity"})
    text = (run_sweep if arguments.study == "sweep" else run_learn)(pairs, kept)
    facts = machine()
    say(text)
    save(f"sensitivity_{arguments.study}", {"machine": facts, "text": text})
    if not arguments.no_readme:
        put_into_readme(f"sensitivity {arguments.study}", f"{text}\n\n{in_words(facts)}.")


if __name__ == "__main__":
    main()
