"""Learned against fixed: every scene judged by models that never saw it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial

import torch

from torchreg.benchmark.bootstrap import bootstrap
from torchreg.benchmark.rows import Rows
from torchreg.benchmark.sensitivity.measure import Worth, worth
from torchreg.benchmark.sensitivity.sweep import measured, remembered
from torchreg.benchmark.sensitivity.variants import BETTER_RULE, PAPER_RULE
from torchreg.benchmark.tables import markdown_table
from torchreg.descriptors.learned import LearnedColor
from torchreg.learning.prepared import PreparedPair
from torchreg.learning.training import TrainingOptions, describe_with, train_color

FIXED = {
    "the paper's rule": PAPER_RULE,
    "hue, saturation, value, not equalized": BETTER_RULE,
    "the same, square roots": replace(BETTER_RULE, root=1.0),
}
UNTRAINED, LEARNED = "the model before training", "learned"
RANSAC_SEEDS = (0, 1, 2)
HEAD = ["features", "inlier ratio (95 %)", "change against the paper's rule (95 %)", "found"]


def new_model(seed: int) -> LearnedColor:
    """An untrained model; the seed draws the hidden weights."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return LearnedColor()


def trained_model(pairs: Sequence[PreparedPair], options: TrainingOptions) -> LearnedColor:
    """A model trained on these pairs, every scene drawn as often."""
    model = new_model(options.seed)
    train_color(model, evenly(pairs), options)
    return model


def judged_by_others(
    pairs: Sequence[PreparedPair],
    seeds: Sequence[int],
    options: TrainingOptions,
    kept: Rows,
    *,
    report: Callable[[str], None] | None = None,
) -> dict[str, list[Worth]]:
    """The worth of fixed and learned features on every pair, the mean over seeds.

    For every scene and seed a model is trained on the pairs of all other scenes, drawn evenly over scenes, and
    measured on this one.
    """
    found = {name: [measured(pair, variant, kept) for pair in pairs] for name, variant in FIXED.items()}
    plain = cache(partial(new_model, 0))
    found[UNTRAINED] = [_measured(pair, plain, options, kept, "untrained") for pair in pairs]
    by_seed: dict[int, dict[str, Worth]] = {seed: {} for seed in seeds}
    for scene in dict.fromkeys(pair.scene for pair in pairs):
        tests = [pair for pair in pairs if pair.scene == scene]
        others = [pair for pair in pairs if pair.scene != scene]
        for seed in seeds:
            trained = cache(partial(trained_model, others, replace(options, seed=seed)))  # only where it is needed
            for pair in tests:
                by_seed[seed][pair.name] = _measured(pair, trained, options, kept, f"learned without {scene} {seed}")
            if report is not None:
                mean = sum(by_seed[seed][pair.name].inlier_ratio for pair in tests) / len(tests)
                report(f"{scene}, seed {seed}: inlier ratio {mean:.3f}")
    found[LEARNED] = [
        Worth(*(sum(values) / len(seeds) for values in zip(*(by_seed[seed][pair.name] for seed in seeds), strict=True)))
        for pair in pairs
    ]
    return found


def evenly(pairs: Sequence[PreparedPair]) -> list[PreparedPair]:
    """Pairs repeated so that every scene is drawn about as often."""
    scenes: dict[str, list[PreparedPair]] = {}
    for pair in pairs:
        scenes.setdefault(pair.scene, []).append(pair)
    most = max(map(len, scenes.values()))
    return [pair for own in scenes.values() for pair in own * max(1, round(most / len(own)))]


def learned_table(pairs: Sequence[PreparedPair], found: dict[str, list[Worth]]) -> str:
    """Markdown, scene by scene and over all of them."""
    rows = []
    base = found[next(iter(FIXED))]
    for scene in [*dict.fromkeys(pair.scene for pair in pairs), "all"]:
        chosen = [i for i, pair in enumerate(pairs) if scene in ("all", pair.scene)]
        for name, worths in found.items():
            ratio = bootstrap([worths[i].inlier_ratio for i in chosen])
            change = bootstrap([worths[i].inlier_ratio - base[i].inlier_ratio for i in chosen])
            hits = sum(worths[i].found for i in chosen)
            rows.append(
                [
                    scene if name == next(iter(found)) else "",
                    name,
                    f"{ratio.value:.3f} ({ratio.low:.3f} to {ratio.high:.3f})",
                    "" if worths is base else f"{change.value:+.3f} ({change.low:+.3f} to {change.high:+.3f})",
                    f"{hits:.1f} / {len(chosen)}",
                ]
            )
    return markdown_table(["scene", *HEAD], rows)


def _measured(
    pair: PreparedPair,
    model: Callable[[], LearnedColor],
    options: TrainingOptions,
    kept: Rows,
    name: str,
) -> Worth:
    def run() -> Worth:
        radius = options.color_radius * pair.voxel
        with torch.no_grad():
            features = describe_with(model(), pair.source, radius), describe_with(model(), pair.target, radius)
        return worth(pair, features, RANSAC_SEEDS)

    return remembered(kept, f"{pair.name} {name} {options}", run)
