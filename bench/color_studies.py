"""Two studies of the color block: one choice swept at a time, and learned against fixed on unseen scenes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import cache, partial
from pathlib import Path
from statistics import fmean

import torch
from color_variants import BETTER_RULE, PAPER_RULE, Variant, Worth, around, described, label, worth

from torchreg.benchmark.core.bootstrap import bootstrap
from torchreg.benchmark.core.rows import Rows
from torchreg.benchmark.core.tables import markdown_table
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
SWEEP_HEAD = ["choice", "value", "inlier ratio", "change against the center (95 %)", "found"]
LEARNED_HEAD = ["scene", "features", "inlier ratio (95 %)", "change against the paper's rule (95 %)", "found"]

Swept = dict[str, dict[str, list[Worth]]]
"""By axis and value, in the order of the pairs."""


def sweep(
    pairs: Sequence[PreparedPair],
    center: Variant,
    kept: Rows,
    *,
    report: Callable[[str], None] | None = None,
) -> Swept:
    """The worth of every variant around ``center``, by axis and value, in the order of the pairs."""
    swept: Swept = {}
    for axis, variants in around(center).items():
        swept[axis] = {}
        for variant in variants:
            key = label(getattr(variant, axis))
            swept[axis][key] = [measured(pair, variant, kept) for pair in pairs]
            if report is not None:
                report(f"{axis} {key}")
    return swept


def measured(pair: PreparedPair, variant: Variant, kept: Rows) -> Worth:
    """The worth of a variant on a pair, from the kept or anew."""
    key = f"{pair.name} {sorted(asdict(variant).items())}"
    return remembered(kept, key, lambda: worth(pair, described(pair, variant)))


def remembered(kept: Rows, key: str, measure: Callable[[], Worth]) -> Worth:
    """What was measured under this key, measured and kept now if it was not."""
    if key not in kept:
        kept.add({"key": key, **measure()._asdict()})
    row = kept[key]
    return Worth(row["inlier_ratio"], row["found"])


def sweep_table(swept: Swept, center: Variant) -> str:
    """Markdown: the mean inlier ratio, its change against the center with an interval over pairs, and pairs found."""
    rows = []
    for axis, values in swept.items():
        chosen = label(getattr(center, axis))
        for value, worths in values.items():
            change = bootstrap([a.inlier_ratio - b.inlier_ratio for a, b in zip(worths, values[chosen], strict=True)])
            hits = sum(one.found for one in worths)
            rows.append(
                [
                    axis.replace("_", " ") if value == next(iter(values)) else "",
                    f"**{value}**" if value == chosen else value,
                    f"{sum(one.inlier_ratio for one in worths) / len(worths):.3f}",
                    "" if value == chosen else f"{change.value:+.3f} ({change.low:+.3f} to {change.high:+.3f})",
                    f"{hits:g} / {len(worths)}",
                ]
            )
    return markdown_table(SWEEP_HEAD, rows)


def draw_sweep(pairs: Sequence[PreparedPair], swept: Swept, chosen: dict[str, str], path: Path) -> Path:
    """Draw and save; ``chosen`` names the center's value on every axis, marked by a line."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    scenes = list(dict.fromkeys(pair.scene for pair in pairs))
    colors = mpl.color_sequences["tab10"]
    figure = Figure(figsize=(13, 6.2), layout="constrained")
    for place, (axis, values) in enumerate(swept.items()):
        panel = figure.add_subplot(2, 4, place + 1)
        names = [name.replace("hue", "h").replace("saturation", "s").replace("value", "v") for name in values]
        for number, scene in enumerate(scenes):
            of_scene = [i for i, pair in enumerate(pairs) if pair.scene == scene]
            means = [fmean(worths[i].inlier_ratio for i in of_scene) for worths in values.values()]
            panel.plot(
                range(len(names)), means, "o-", ms=4, lw=1.4, color=colors[number], label=scene.replace("_", " ")
            )
        panel.axvline(list(values).index(chosen[axis]), color="0.8", lw=6, zorder=0)
        panel.set_xticks(range(len(names)), names, rotation=30 if max(map(len, names)) > 4 else 0)
        panel.set_title(axis.replace("_", " "), fontsize=10)
        panel.set_ylim(bottom=0)
        panel.spines[["top", "right"]].set_visible(False)
        if place % 4 == 0:
            panel.set_ylabel("inlier ratio")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(scenes), frameon=False, fontsize=9)
    figure.savefig(path, dpi=120)
    return path


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
    by_features = {name: [measured(pair, variant, kept) for pair in pairs] for name, variant in FIXED.items()}
    plain = cache(partial(new_model, 0))
    by_features[UNTRAINED] = [_measured(pair, plain, options, kept, "untrained") for pair in pairs]
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
    by_features[LEARNED] = [
        Worth(*(sum(values) / len(seeds) for values in zip(*(by_seed[seed][pair.name] for seed in seeds), strict=True)))
        for pair in pairs
    ]
    return by_features


def evenly(pairs: Sequence[PreparedPair]) -> list[PreparedPair]:
    """Pairs repeated so that every scene is drawn about as often."""
    scenes: dict[str, list[PreparedPair]] = {}
    for pair in pairs:
        scenes.setdefault(pair.scene, []).append(pair)
    most = max(map(len, scenes.values()))
    return [pair for of_scene in scenes.values() for pair in of_scene * max(1, round(most / len(of_scene)))]


def learned_table(pairs: Sequence[PreparedPair], by_features: dict[str, list[Worth]]) -> str:
    """Markdown, scene by scene and over all of them."""
    rows = []
    base = by_features[next(iter(FIXED))]
    for scene in [*dict.fromkeys(pair.scene for pair in pairs), "all"]:
        chosen = [i for i, pair in enumerate(pairs) if scene in ("all", pair.scene)]
        for name, worths in by_features.items():
            ratio = bootstrap([worths[i].inlier_ratio for i in chosen])
            change = bootstrap([worths[i].inlier_ratio - base[i].inlier_ratio for i in chosen])
            hits = sum(worths[i].found for i in chosen)
            rows.append(
                [
                    scene if name == next(iter(by_features)) else "",
                    name,
                    f"{ratio.value:.3f} ({ratio.low:.3f} to {ratio.high:.3f})",
                    "" if worths is base else f"{change.value:+.3f} ({change.low:+.3f} to {change.high:+.3f})",
                    f"{hits:.1f} / {len(chosen)}",
                ]
            )
    return markdown_table(LEARNED_HEAD, rows)


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
