"""What gradients cost: soft descriptors, forward and backward, against hard ones.

    python bench/gradients.py             writes bench/results/gradients.json and docs/benchmarks/gradients.md

10,000 points of the simulated mall with 100 neighbors each (FPFH) and those within 2 of 5 radii (PCFH), neighborhoods
at hand, gradients to points, normals and colors. Medians of repeated runs in turn after a warm-up. Peak memory in
processes of their own, above clouds and neighborhoods, by pieces as the library does it and by plain autograd.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import torch
from common import bench_parser, in_words, interleaved, machine, peak_bytes, publish, save, spread, table

import torchreg as tr

POINTS, SLOTS = 10_000, 100
NAMES = ("FPFH", "PCFH", "FPFH + PCFH")

MAKE = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
import gradients
run = gradients.runs(*gradients.prepared())["FPFH + PCFH"]["soft, back"]
"""
PLAIN = """
from torchreg.descriptors.soft import rows
rows._ByRows.call = lambda kernel, _, near, *inputs: rows._whole(kernel, near, *inputs)
"""

Run = Callable[[], Any]


def prepared() -> tuple[tr.Clouds, tr.Neighborhoods, tr.Neighborhoods]:
    cloud = tr.random_downsample(tr.datasets.mall(seed=0).source, POINTS)
    near = tr.neighbors(cloud, 5.0, SLOTS)
    return tr.estimate_normals(cloud, near.restrict(2.0, 30)), near, near.restrict(2.0)


def runs(cloud: tr.Clouds, near: tr.Neighborhoods, color: tr.Neighborhoods) -> dict[str, dict[str, Run]]:
    """Hard, soft, and soft with its way back, by descriptor."""
    points, normals, colors = (value.clone().requires_grad_() for value in (cloud.points, cloud.normals, cloud.colors))
    leaf = tr.Clouds(points=points, normals=normals, colors=colors)
    made = {
        "FPFH": lambda of, binning: [tr.fpfh(of, near, binning=binning).values],
        "PCFH": lambda of, binning: [tr.pcfh(of, color, binning=binning).values],
    }
    made["FPFH + PCFH"] = lambda of, binning: [*made["FPFH"](of, binning), *made["PCFH"](of, binning)]
    leaves = {"FPFH": (points, normals), "PCFH": (points, colors), "FPFH + PCFH": (points, normals, colors)}

    def back(name: str) -> object:
        values = torch.cat(made[name](leaf, "soft"), dim=1)
        return torch.autograd.grad(values, leaves[name], torch.ones_like(values))

    return {
        name: {
            "hard": lambda name=name: made[name](cloud, "hard"),
            "soft": lambda name=name: made[name](cloud, "soft"),
            "soft, back": lambda name=name: back(name),
        }
        for name in NAMES
    }


def compiled(run: Run) -> Run:
    def inside() -> object:
        with tr.compiled_kernels():
            return run()

    return inside


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("--repeats", type=int, default=9)
    arguments = parser.parse_args()
    lines, content = [], {}
    for name, made in runs(*prepared()).items():
        every = {**made, **{f"{kind}, compiled": compiled(run) for kind, run in made.items()}}
        seconds = interleaved(every, arguments.repeats)
        hard = median(seconds["hard"])
        content[name] = seconds
        for suffix in ("", ", compiled"):
            kinds = [seconds[f"{kind}{suffix}"] for kind in made]
            against = f"{median(kinds[2]) / hard:.1f}, {median(kinds[2]) / median(kinds[0]):.1f}"
            lines.append(
                [f"{name}{suffix}", *map(spread, kinds), against if suffix else f"{median(kinds[2]) / hard:.1f}"]
            )
            print(lines[-1], flush=True)
    bytes_ = {kind: peak_bytes(MAKE + more, "run()")["bytes"] for kind, more in (("pieces", ""), ("plain", PLAIN))}
    facts = machine()
    last = "forward and back / hard (compiled: eager hard, compiled hard)"
    head = ["10,000 points, 100 neighbors", "hard", "soft", "soft, forward and back", last]
    text = table(head, lines)
    text += (
        f"\n\nForward and back of both, peak memory above clouds and neighborhoods: {bytes_['pieces'] / 2**20:.0f} "
        f"MiB, by plain autograd {bytes_['plain'] / 2**20:.0f} MiB. Medians of {arguments.repeats}, least and most in "
        f"brackets; {in_words(facts)}."
    )
    print(text)
    save("gradients", {"machine": facts, "seconds": content, "bytes": bytes_, "text": text})
    if not arguments.no_docs:
        publish("gradients", text)


if __name__ == "__main__":
    main()
