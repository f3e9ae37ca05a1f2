"""Batches: throughput against Open3D and against single calls, equal bits, and peak memory.

    python bench/batch.py                 writes bench/results/batch.json and the tables in README.md

*Mixed*: 64 pairs of two stations of simulated malls, 200 to 20,000 points a cloud, evenly in the logarithm, sizes of
source and target drawn apart; lengths derived from each pair. torchreg registers them in one call, Open3D one after
another, both with two threads, in turn in one process. *Small*: 256 pairs of 1,000 points in one call, against the
loop over single calls. Medians of the runs after a warm-up. *Memory*: peak of a process of its own above what imports
and clouds hold.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
from dataclasses import replace
from statistics import median
from typing import Any

import torch
from common import in_words, interleaved, machine, save, spread, table
from readme import put_into_readme
from torch import Tensor

import torchreg as tr

MIXED, SMALL, SMALL_POINTS, MALLS = 64, 256, 1000, 16
SIZES = (200, 20_000)

MEMORY = """
import json, sys, torch
import torchreg as tr
from torchreg.open3d_loader import load_open3d
from torchreg.registration import describe_clouds
from torchreg.registration.scale import scaled_options
load_open3d()
def status(name):
    return [int(line.split()[1]) * 1024 for line in open('/proc/self/status') if line.startswith(name)][0]
{make}
open('/proc/self/clear_refs', 'w').write('5')  # the peak counts from here
before = status('VmRSS')
{work}
print(json.dumps(status('VmHWM') - before))
"""
MILLION = """
pair = tr.datasets.mall(seed=0, angular_step=0.12)
clouds = [tr.random_downsample(cloud, 1_000_000) for cloud in (pair.source, pair.target)]
assert all(len(cloud.points) == 1_000_000 for cloud in clouds)
del pair
"""
MANY = """
def cloud(seed, station):
    pair = tr.datasets.mall(seed=seed % 8, angular_step=0.8)
    return tr.random_downsample((pair.source, pair.target)[station], 10_000,
                                generator=torch.Generator().manual_seed(seed))
source, target = (tr.Clouds.pack([cloud(seed, station) for seed in range(256)]) for station in range(2))
"""
PEAKS = {
    "one pair of 1,000,000 points, default": (MILLION, "tr.register(*clouds)"),
    "describing 1,000,000 points as they are (100 neighbors, FPFH and color)": (
        MILLION,
        "describe_clouds(clouds[0], scaled_options(float(tr.spacing(clouds[0]))))",
    ),
    "256 pairs of 10,000 points, default, one call": (MANY, "tr.register(source, target)"),
    "the same within max_bytes of 1 GiB": (MANY, "tr.register(source, target, max_bytes=1 << 30)"),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--no-readme", action="store_true", help="leave README.md as it is")
    parser.add_argument("--repeats", type=int, default=3, help="counted runs of each")
    parser.add_argument("--only", choices=("mixed", "small", "memory"), help="one part, printed and not saved")
    arguments = parser.parse_args()
    parts = {"mixed": mixed, "small": small, "memory": memory}
    content, texts = {}, []
    for name, part in parts.items():
        if arguments.only in (None, name):
            content[name], text = part(arguments.repeats)
            print(text, flush=True)
            texts.append(text)
    if arguments.only is None:
        facts = machine()
        save("batch", {"machine": facts, **content})
        text = "\n\n".join([*texts, f"Medians of {arguments.repeats} runs (least to most), {in_words(facts)}."])
        if not arguments.no_readme:
            put_into_readme("batch", text)


def mixed(repeats: int) -> tuple[dict[str, Any], str]:
    """64 pairs of mixed sizes against Open3D, and against themselves one by one."""
    generator = torch.Generator().manual_seed(0)
    ratio = math.log(SIZES[1] / SIZES[0])
    sizes = [round(SIZES[0] * math.exp(ratio * k / (MIXED - 1))) for k in range(MIXED)]
    pairs = scans(
        list(zip(sizes, (sizes[k] for k in torch.randperm(MIXED, generator=generator).tolist()), strict=True))
    )
    source, target = (tr.Clouds.pack(side) for side in pairs)
    derived = tr.derive_options(source, target)
    content: dict[str, Any] = {"sizes": [source.lengths, target.lengths]}
    rows = []
    for words, confidence in (("at confidence 0.999", 0.999), ("all of them", 1.0)):
        plain = [geometry(option, confidence) for option in derived]
        runs = {
            f"FPFH, RANSAC, 600,000 hypotheses, {words}": lambda o=plain: tr.register(source, target, o),
            "default (balanced)": lambda: tr.register(source, target),
            "fast": lambda: tr.register(source, target, effort="fast"),
            "Open3D": lambda o=plain: tr.reference.open3d.register(source, target, o),
        }
        if confidence == 1.0:
            runs.pop("fast")
        seconds = interleaved(runs, repeats)
        theirs = median(seconds["Open3D"])
        content[f"confidence {confidence}"] = seconds
        for name in runs:
            if name != "Open3D":
                ours = median(seconds[name])
                rows.append([name, f"Open3D, {words}", spread(seconds[name]), spread(seconds["Open3D"]),
                             f"{MIXED / ours:.1f}", f"{theirs / ours:.1f}"])  # fmt: skip
    content["equal"] = {
        name: equal_to_single(source, target, effort) for name, effort in (("balanced", None), ("fast", "fast"))
    }
    same = all(content["equal"].values())
    head = [f"{MIXED} pairs, {SIZES[0]:,} to {SIZES[1]:,} points", "against"]
    head += ["torchreg, one call", "Open3D, pair by pair", "pairs a second", "times faster"]
    words = "Every pair's result has the bits that it has alone." if same else "NOT EQUAL TO SINGLE CALLS."
    return content, f"{table(head, rows)}\n\n{words}"


def small(repeats: int) -> tuple[dict[str, Any], str]:
    """256 pairs of 1,000 points in one call against the loop over single calls."""
    pairs = scans([(SMALL_POINTS, SMALL_POINTS)] * SMALL)
    source, target = (tr.Clouds.pack(side) for side in pairs)
    content: dict[str, Any] = {}
    rows = []
    for name, effort in (("balanced (default)", None), ("fast", "fast"), ("plain", "plain")):
        runs = {
            "one call": lambda e=effort: tr.register(source, target, effort=e),
            "loop": lambda e=effort: [tr.register(one, other, effort=e) for one, other in zip(*pairs, strict=True)],
        }
        seconds = interleaved(runs, repeats)
        gain = median(seconds["loop"]) / median(seconds["one call"])
        content[name] = {**seconds, "gain": gain}
        rows.append([name, spread(seconds["one call"]), spread(seconds["loop"]), f"{gain:.2f}"])
    return content, table(
        [f"{SMALL} pairs of {SMALL_POINTS:,} points", "one call", "loop over single calls", "times faster"], rows
    )


def memory(repeats: int) -> tuple[dict[str, Any], str]:
    """Peaks of processes of their own."""
    found = {}
    for name, (make, work) in PEAKS.items():
        code = MEMORY.format(make=make, work=work)
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        found[name] = json.loads(done.stdout.strip().splitlines()[-1])
    rows = [[name, f"{value / 2**30:.2f} GiB"] for name, value in found.items()]
    return found, table(["peak memory, above imports and clouds", ""], rows)


def scans(sizes: list[tuple[int, int]]) -> tuple[list[tr.Clouds], list[tr.Clouds]]:
    """Random choices of so many points of the two stations of some malls."""
    malls = [tr.datasets.mall(seed=seed, angular_step=0.7) for seed in range(MALLS)]
    sides: tuple[list[tr.Clouds], list[tr.Clouds]] = ([], [])
    for number, both in enumerate(sizes):
        pair = malls[number % MALLS]
        for side, cloud, size in zip(sides, (pair.source, pair.target), both, strict=True):
            generator = torch.Generator().manual_seed(number)
            side.append(tr.random_downsample(cloud, size, generator=generator))
    return sides


def geometry(options: tr.RegistrationOptions, confidence: float) -> tr.RegistrationOptions:
    """The plain procedure on FPFH alone, which Open3D does too."""
    ransac = replace(options.ransac, confidence=confidence)
    return replace(options, color=(), color_weights=(), effort="plain", solver="ransac", ransac=ransac)


def equal_to_single(source: tr.Clouds, target: tr.Clouds, effort: str | None) -> bool:
    """Whether every pair of the batch has the very numbers that it has alone."""
    together = tr.register(source, target, effort=effort)
    for b in range(len(source)):
        alone = tr.register(source.select(b), target.select(b), effort=effort)
        begin, end = together.correspondences.offsets[b : b + 2].tolist()
        pieces = [
            (alone.T_target_source[0], together.T_target_source[b]),
            (alone.inliers, together.inliers[begin:end]),
            (alone.correspondences.score, together.correspondences.score[begin:end]),
            (alone.probability, together.probability[b : b + 1]),
            (alone.information[0], together.information[b]),
        ]
        if not all(same(one, other) for one, other in pieces) or alone.reason[0] != together.reason[b]:
            return False
    return True


def same(one: Tensor, other: Tensor) -> bool:
    return torch.equal(one.nan_to_num(12345.0), other.nan_to_num(12345.0))


if __name__ == "__main__":
    main()
