"""The paper's open questions: how many bins, how wide, how heavy, which channels; and whether learning beats the rule.

    python bench/sensitivity.py sweep      one choice varied at a time; table and chart (--per-scene 3: a quarter of it)
    python bench/sensitivity.py learn      weights trained on some scenes, judged on others
    python bench/sensitivity.py ship       train on all scenes and write the weights that tr.LEARNED reads

Pairs: the colored real ones and simulated malls, averaged over each pair's voxels v: normals 2 v / 30, FPFH 5 v / 100.
Inlier ratio: share of the mutual matches nearer than 2 v under the truth. Found: RANSAC over 100,000 hypotheses, inlier
threshold 1.5 v, ends within 15 degrees and 6 v of the truth. Measurements go to bench/results/sensitivity/ as they
come; an unfinished run is resumed.
"""

from __future__ import annotations

from collections.abc import Sequence

from color_studies import draw_sweep, judged_by_others, learned_table, sweep, sweep_table, trained_model
from color_variants import AXES, BETTER_RULE, PAPER_RULE, label
from common import DOCS, REAL, RESULTS, bench_parser, in_words, listed_pairs, machine, publish, save

import torchreg as tr
from torchreg.benchmark.core.real_pairs import read_real_pairs
from torchreg.benchmark.core.rows import Rows
from torchreg.descriptors.learned import SHIPPED, save_weights
from torchreg.learning.prepared import PreparedPair, prepare_pair
from torchreg.learning.training import TrainingOptions

KEPT = RESULTS / "sensitivity"
MALLS = range(4)
MALL_VOXEL = 0.2  # meters
SEEDS = range(3)
OPTIONS = TrainingOptions()


def simulated_pairs() -> list[PreparedPair]:
    """Two stations in a mall, one pair a seed."""
    halls = {seed: tr.datasets.mall(seed=seed) for seed in MALLS}
    return [
        prepare_pair(
            hall.source, hall.target, hall.T_target_source, MALL_VOXEL, name=f"mall_{seed}", scene="simulated malls"
        )
        for seed, hall in halls.items()
    ]


def real_pairs() -> list[PreparedPair]:
    """The colored pairs of the list beside the checkout."""
    return [
        prepare_pair(
            tr.read_cloud(pair.source),
            tr.read_cloud(pair.target),
            pair.T_target_source,
            pair.voxel,
            name=pair.name,
            scene=pair.scene,
        )
        for pair in read_real_pairs(REAL)
        if pair.colored
    ]


def say(line: str) -> None:
    print(line, flush=True)


def run_sweep(pairs: Sequence[PreparedPair], kept: Rows) -> str:
    texts = []
    for title, center, picture in (
        ("Around the paper's rule", PAPER_RULE, "sensitivity"),
        ("Around hue, saturation and value, not equalized", BETTER_RULE, "sensitivity_better"),
    ):
        swept = sweep(pairs, center, kept, report=say)
        chosen = {axis: label(getattr(center, axis)) for axis in AXES}
        draw_sweep(pairs, swept, chosen, DOCS / f"{picture}.png")
        texts.append(f"{title}, {len(pairs)} pairs:\n\n{sweep_table(swept, center)}")
    return "\n\n".join(texts)


def run_learn(pairs: Sequence[PreparedPair], kept: Rows) -> str:
    return learned_table(pairs, judged_by_others(pairs, SEEDS, OPTIONS, kept, report=say))


def spread_evenly(pairs: Sequence[PreparedPair], most: int) -> list[PreparedPair]:
    chosen = []
    for scene in dict.fromkeys(pair.scene for pair in pairs):
        of_scene = [pair for pair in pairs if pair.scene == scene]
        step = max(1, len(of_scene) // most)
        chosen += of_scene[::step][:most]
    return chosen


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("study", choices=("sweep", "learn", "ship"))
    parser.add_argument("--per-scene", type=int, help="so many pairs of every scene, spread evenly over its list")
    arguments = parser.parse_args()
    listed_pairs()
    pairs = [*real_pairs(), *simulated_pairs()]
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
    if not arguments.no_docs:
        publish(f"sensitivity {arguments.study}", f"{text}\n\n{in_words(facts)}.")


if __name__ == "__main__":
    main()
