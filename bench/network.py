"""The point network on scenes that it never saw: matches beside those of what ships, and pairs that register finds.

    torchreg train --pairs REAL --pairs HARD --hold-out SCENES --out A        some scenes held out
    torchreg train --pairs REAL --pairs HARD --hold-out THE_OTHERS --out B    and the others
    python bench/network.py A B [--recall] [--per-scene 3]

Every listed pair is judged by the network of the folder that held its scene out. Beside the features of ``torchreg
train`` stand controls: a network as it is drawn, untrained, and the default's features moved to square roots.
Inlier ratio: share of the mutual matches nearer than 2 voxels under the truth; matched: pairs where that is above 0.05.
Found, with --recall: ``register`` at the voxels of the list, by its default and with the network as another block of
weight 1, ends within 15 degrees and 6 voxels of the truth; it is sure where it calls that a success. Measurements are
kept beside each folder's weights as they come; an unfinished run is resumed. Simulated pairs are those of the last
folder.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from statistics import fmean
from typing import Any

import torch
from common import bench_parser, in_words, machine, publish, save, table

import torchreg as tr
from torchreg.benchmark.core.bootstrap import bootstrap
from torchreg.benchmark.core.real_pairs import RealPair
from torchreg.benchmark.core.rows import Rows
from torchreg.cli.training_data import training_data
from torchreg.learning.held_out import Describe, baselines, described_by, match_quality, network_features, with_network
from torchreg.learning.network_training import drawn_network, load_network
from torchreg.learning.posed_pairs import PosedPair
from torchreg.metrics import rre, rte

BASE, ROOTED = "default", "default, square roots"
ROTATION, TRANSLATION_VOXELS = 15.0, 6.0
HEAD = [
    "held-out scenes",
    "pairs",
    "features",
    "inlier ratio",
    "change against the default (95 %)",
    "inliers",
    "matched",
]
RECALL_HEAD = ["held-out scenes", "pairs", "options", "found", "of these sure", "wrong and sure"]


def methods_of(network: tr.nn.PointNetwork) -> dict[str, Describe]:
    """All features that are compared, by name."""
    drawn = network_features(drawn_network(0))
    return {
        **baselines(),
        ROOTED: lambda side, voxel: described_by(side, rooted(voxel)),
        "untrained": drawn["network"],
        "default + untrained": drawn["default + network"],
        **network_features(network),
        f"{ROOTED} + network": lambda side, voxel: described_by(side, with_network(rooted(voxel), network, voxel)),
    }


def rooted(voxel: float) -> tr.RegistrationOptions:
    """The default's options with all histograms moved to square roots; ``voxel`` in meters."""
    return replace(tr.options_for(voxel), root=1.0)


def measured(folder: Path, *, recall: bool, per_scene: int | None) -> list[dict[str, Any]]:
    """Rows of the held-out pairs of a run and all features, and with ``recall`` of both options.

    With ``per_scene`` so many pairs of every listed scene, spread evenly over its list.
    """
    state = torch.load(folder / "checkpoint.pt", weights_only=True)
    run = state["run"]
    data = training_data(run["places"], [Path(path) for path in run["pairs"]], run["held_out"])
    data = replace(data, held_out=spread_evenly(data.held_out, per_scene))
    network = load_network(folder / "weights.pt")
    kept = Rows(folder, {"study": "network", "step": state["training"]["done"]})
    methods = methods_of(network)
    rows: list[dict[str, Any]] = []
    for number, posed in enumerate(data.to_judge()):
        for name, describe in methods.items():
            judge = partial(_matches, name, describe, posed)
            rows.append(_kept(kept, f"{posed.group} {posed.pair.name} {name}", judge))
        for name, block in (("default", None), ("default + network", network)) if recall else ():
            rows.append(
                _kept(kept, f"{posed.group} {posed.pair.name} register {name}", partial(_found, name, block, posed))
            )
        print(f"{folder.name}: {number + 1} of {data.judged}, {posed.pair.name}", flush=True)
    return rows


def spread_evenly(pairs: Sequence[RealPair], most: int | None) -> tuple[RealPair, ...]:
    """At most so many pairs of every scene; ``None``: all."""
    chosen: list[RealPair] = []
    for scene in dict.fromkeys(pair.scene for pair in pairs):
        of_scene = [pair for pair in pairs if pair.scene == scene]
        count = len(of_scene) if most is None else min(most, len(of_scene))
        chosen += [of_scene[place * len(of_scene) // count] for place in range(count)]
    return tuple(chosen)


def _kept(kept: Rows, key: str, measure: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    if key not in kept:
        kept.add({"key": key, **measure()})
    return kept[key]


def _matches(name: str, describe: Describe, posed: PosedPair) -> dict[str, Any]:
    return {"kind": "matches", **asdict(next(match_quality({name: describe}, [posed])))}


def _found(name: str, network: tr.nn.PointNetwork | None, posed: PosedPair) -> dict[str, Any]:
    pair, voxel = posed.pair, posed.voxel
    options = tr.options_for(voxel, colored=pair.source.colors is not None, voxel_size=voxel)
    if network is not None:
        options = with_network(options, network, voxel)
    result = tr.register(pair.source, pair.target, options)
    truth = pair.T_target_source[None]
    turned, moved = float(rre(truth, result.T_target_source)), float(rte(truth, result.T_target_source))
    found = turned < ROTATION and moved < TRANSLATION_VOXELS * voxel
    sure = bool(result.success[0])
    return {"kind": "register", "features": name, "pair": pair.name, "group": posed.group, "found": found, "sure": sure}


def match_table(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown: means by group and features, with an interval of the change against the default over pairs."""
    shown = []
    for group in [*dict.fromkeys(row["group"] for row in rows), "all"]:
        some = [row for row in rows if group in ("all", row["group"])]
        base = [row["inlier_ratio"] for row in some if row["features"] == BASE]
        for name in dict.fromkeys(row["features"] for row in some):
            mine = [row for row in some if row["features"] == name]
            ratios = [row["inlier_ratio"] for row in mine]
            change = bootstrap([a - b for a, b in zip(ratios, base, strict=True)])
            first = name == some[0]["features"]
            shown.append(
                [
                    group if first else "",
                    f"{len(mine)}" if first else "",
                    name,
                    f"{fmean(ratios):.3f}",
                    "" if name == BASE else f"{change.value:+.3f} ({change.low:+.3f} to {change.high:+.3f})",
                    f"{fmean(row['inliers'] for row in mine):.0f}",
                    f"{sum(ratio > 0.05 for ratio in ratios)}",
                ]
            )
    return table(HEAD, shown)


def recall_table(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown: pairs found by group and options."""
    shown = []
    for group in [*dict.fromkeys(row["group"] for row in rows), "all"]:
        some = [row for row in rows if group in ("all", row["group"])]
        for name in dict.fromkeys(row["features"] for row in some):
            mine = [row for row in some if row["features"] == name]
            first = name == some[0]["features"]
            found = [row for row in mine if row["found"]]
            sure, wrong = sum(row["sure"] for row in found), sum(row["sure"] and not row["found"] for row in mine)
            cells = name, f"{len(found)}", f"{sure}", f"{wrong}"
            shown.append([group if first else "", f"{len(mine)}" if first else "", *cells])
    return table(RECALL_HEAD, shown)


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("folders", nargs="+", type=Path, metavar="FOLDER", help="of torchreg train")
    parser.add_argument("--recall", action="store_true", help="also register every pair, both ways")
    parser.add_argument("--per-scene", type=int, metavar="COUNT", help="so many pairs of every scene, spread evenly")
    arguments = parser.parse_args()
    options = {"recall": arguments.recall, "per_scene": arguments.per_scene}
    rows = {row["key"]: row for folder in arguments.folders for row in measured(folder, **options)}
    matches = [row for row in rows.values() if row["kind"] == "matches"]
    found = [row for row in rows.values() if row["kind"] == "register"]
    text = "\n\n".join([match_table(matches), *([recall_table(found)] if found else [])])
    facts = machine()
    print(text)
    save("network", {"machine": facts, "rows": list(rows.values())})
    if not arguments.no_docs:
        publish("network", f"{text}\n\n{in_words(facts)}.")


if __name__ == "__main__":
    main()
