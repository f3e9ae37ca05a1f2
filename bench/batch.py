"""Batches: throughput against Open3D and against single calls, equal bits, and peak memory.

    python bench/batch.py                 writes bench/results/batch.json and docs/benchmarks/batch.md

*Mixed*: 64 pairs made of the colored real ones, thinned by voxels to 200 to 20,000 points (evenly in the logarithm);
lengths derived from each pair. torchreg registers them in one call, Open3D one after another, both with two threads,
in turn in one process; torchreg batch on two processes, from files. *Found* counts pairs within 15 degrees and 4 inlier
thresholds of the truth, trusted or not (torchreg batch: trusted). *Small*: 256 pairs of 1,000 points of simulated malls
in one call, against the loop over single calls. *Memory*: peak of a process of its own above what imports and clouds
hold. Medians of the runs after a warm-up on some of the pairs.
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import torch
from common import (
    REAL,
    RESULTS,
    bench_parser,
    in_words,
    interleaved,
    listed_pairs,
    machine,
    peak_bytes,
    publish,
    save,
    spread,
    table,
)
from torch import Tensor

import torchreg as tr
from torchreg.benchmark.speed.batches import small_pairs

MIXED, SMALL, SMALL_POINTS = 64, 256, 1000
SIZES = (200, 20_000)

MILLION = """
from dataclasses import replace
from torchreg.registration import describe_clouds
from torchreg.registration import options_for
pair = tr.datasets.mall(seed=0, angular_step=0.2)
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
    "one pair of 1,000,000 points a cloud, voxels of 0.1 m": (
        MILLION,
        "tr.register(*clouds, replace(options_for(0.1), voxel_size=0.1))",
    ),
    "describing 1,000,000 points as they are (100 neighbors, FPFH and color)": (
        MILLION,
        "describe_clouds(clouds[0], options_for(float(tr.spacing(clouds[0]))))",
    ),
    "256 pairs of 10,000 points, default, one call": (MANY, "tr.register(source, target)"),
    "the same within max_bytes of 1 GiB": (MANY, "tr.register(source, target, max_bytes=1 << 30)"),
}


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("--repeats", type=int, default=3, help="counted runs of each")
    parser.add_argument("--only", choices=("mixed", "small", "memory"), help="one part; the others stay as they are")
    arguments = parser.parse_args()
    saved = RESULTS / "batch.json"
    content: dict[str, Any] = json.loads(saved.read_text()) if saved.exists() else {}
    for name, part in (("mixed", mixed), ("small", small), ("memory", memory)):
        if arguments.only in (None, name):
            figures, text = part(arguments.repeats)
            facts = machine()
            content[name] = {"machine": facts, **figures, "text": f"{text}\n\n{in_words(facts)}."}
            print(content[name]["text"], flush=True)
            save("batch", content)
    if not arguments.no_docs:
        publish("batch", "\n\n".join(content[name]["text"] for name in ("mixed", "small", "memory") if name in content))


def mixed(repeats: int) -> tuple[dict[str, Any], str]:
    """64 pairs of mixed sizes against Open3D, and against themselves one by one."""
    pairs, truths = thinned_real()
    source, target = (tr.Clouds.pack(side) for side in pairs)
    derived = tr.derive_options(source, target)
    plain = {confidence: [geometry(option, confidence) for option in derived] for confidence in (0.999, 1.0)}
    equal = {str(effort): equal_to_single(source, target, effort) for effort in (None, "fast", "plain")}
    few = list(range(0, MIXED, 8))
    tr.register(source.select(few), target.select(few))
    tr.reference.open3d.register(source.select(few), target.select(few), [plain[0.999][b] for b in few])
    shared = "FPFH, RANSAC, 600,000 hypotheses"
    same = tr.batch.PairSettings(scale="pair", effort="plain", solver="ransac", no_color=True, confidence=0.999)
    with tempfile.TemporaryDirectory() as folder:
        files = Files(Path(folder), pairs, truths)
        files.run(same, few)  # starts the server of processes
        runs = {
            f"torchreg, {shared}, confidence 0.999": lambda: tr.register(source, target, plain[0.999]),
            "the same by torchreg batch, 2 processes": lambda: files.run(same),
            "torchreg, fast": lambda: tr.register(source, target, effort="fast"),
            "torchreg, balanced (default)": lambda: tr.register(source, target),
            "the same by torchreg batch, 2 processes ": lambda: files.run(tr.batch.PairSettings(scale="pair")),
            f"Open3D, {shared}, confidence 0.999": lambda: tr.reference.open3d.register(source, target, plain[0.999]),
        }
        every = {
            f"torchreg, {shared}, all": lambda: tr.register(source, target, plain[1.0]),
            f"Open3D, {shared}, all": lambda: tr.reference.open3d.register(source, target, plain[1.0]),
        }
        seconds, results = in_turn(runs, repeats)
        once, further = in_turn(every, 1)
    seconds, results = seconds | once, results | further
    found = {name: count_found(T, truths, derived) for name, T in results.items()}
    early, late = (median(seconds[f"Open3D, {shared}, {words}"]) for words in ("confidence 0.999", "all"))
    rows = []
    for name, spent in seconds.items():
        typical = median(spent)
        ratios = [f"{other / typical:.1f}" for other in (early, late)]
        rows.append([name.strip(), spread(spent), f"{MIXED / typical:.2f}", *ratios, str(found[name])])
    content = {"sizes": [source.lengths, target.lengths], "seconds": seconds, "found": found, "equal": equal}
    sizes = [*source.lengths, *target.lengths]
    head = [f"{MIXED} pairs, {min(sizes):,} to {max(sizes):,} points", "seconds", "pairs a second"]
    head += ["times as fast as Open3D, 0.999", "as Open3D, all", f"found, of {MIXED}"]
    bits = "has" if all(equal.values()) else "DOES NOT HAVE"
    words = (
        f"Medians of {repeats} runs (least to most), of one where all hypotheses are drawn. torchreg batch reads the "
        f"clouds from files and keeps every pair. Every pair's result {bits} the bits that it has alone."
    )
    return content, f"{table(head, rows)}\n\n{words}"


class Files:
    """The pairs as files, and runs of the batch on them, each into a folder of its own."""

    def __init__(self, folder: Path, pairs: tuple[list[tr.Clouds], list[tr.Clouds]], truths: list[Tensor]) -> None:
        self.folder, self.count = folder, len(truths)
        self.runs = 0
        for side, clouds in zip("st", pairs, strict=True):
            for number, cloud in enumerate(clouds):
                tr.write_cloud(folder / f"{side}{number}.npz", cloud)

    def run(self, settings: tr.batch.PairSettings, few: list[int] | None = None) -> Tensor:
        """Register all pairs, or a few; returns the transforms (B, 4, 4), the identity where a pair is refused."""
        self.runs += 1
        out, described = self.folder / f"out{self.runs}", self.folder / f"described{self.runs}"
        described.mkdir()
        pairs = [
            tr.batch.Pair(
                name=str(k),
                source=str(self.folder / f"s{k}.npz"),
                target=str(self.folder / f"t{k}.npz"),
                source_text=f"s{k}.npz",
                target_text=f"t{k}.npz",
                settings=settings,
            )
            for k in (range(self.count) if few is None else few)
        ]
        with tr.batch.Store(out, {}) as store:
            tr.batch.run(pairs, store, tr.batch.LocalEngine(2), described=described, bounds=tr.batch.Bounds(15.0, None))
            rows = store.finished()
        eye = torch.eye(4, dtype=torch.float64)
        listed = [rows[pair.name].line["T_target_source"] for pair in pairs]
        return torch.stack([eye if T is None else torch.tensor(T, dtype=torch.float64).view(4, 4) for T in listed])


def in_turn(runs: dict[str, Any], repeats: int) -> tuple[dict[str, list[float]], dict[str, Tensor]]:
    """Seconds of every run, in turn so that drift hits all alike, and the transforms of each."""
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    transforms = {}
    for _ in range(repeats):
        for name, run in runs.items():
            begin = time.perf_counter()
            result = run()
            seconds[name].append(time.perf_counter() - begin)
            transforms[name] = result if isinstance(result, Tensor) else result.T_target_source
            print(f"{name}: {seconds[name][-1]:.1f} s", file=sys.stderr, flush=True)
    return seconds, transforms


def thinned_real() -> tuple[tuple[list[tr.Clouds], list[tr.Clouds]], list[Tensor]]:
    """The colored real pairs over and over, each time thinned to another size."""
    listed = listed_pairs()
    clouds = {file: tr.read_cloud(REAL / file) for pair in listed for file in (pair["source"], pair["target"])}
    ratio = math.log(SIZES[1] / SIZES[0])
    sizes = [round(SIZES[0] * math.exp(ratio * k / (MIXED - 1))) for k in range(MIXED)]
    order = torch.randperm(MIXED, generator=torch.Generator().manual_seed(0)).tolist()
    sides: tuple[list[tr.Clouds], list[tr.Clouds]] = ([], [])
    colored = [pair for pair in listed if pair["colour"]]
    chosen = [colored[k % len(colored)] for k in range(MIXED)]
    for pair, place in zip(chosen, order, strict=True):
        voxel = voxel_for(clouds[pair["source"]], sizes[place])
        for side, name in zip(sides, ("source", "target"), strict=True):
            side.append(tr.voxel_downsample(clouds[pair[name]], voxel))
    return sides, [torch.tensor(pair["T"], dtype=torch.float64) for pair in chosen]


def voxel_for(cloud: tr.Clouds, size: int) -> float:
    """Meters; the voxel edge that leaves about so many points."""
    low, high = 1e-3, 10.0
    for _ in range(14):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if len(tr.voxel_downsample(cloud, middle).points) > size else (low, middle)
    return high


def count_found(poses: Tensor, truths: list[Tensor], options: tuple[tr.RegistrationOptions, ...]) -> int:
    """Pairs within 15 degrees and four inlier thresholds of the truth."""
    T = torch.stack(truths)
    near = tr.metrics.rte(T, poses)
    bounds = torch.tensor([4 * option.inlier_threshold for option in options], dtype=torch.float64)
    return int(((tr.metrics.rre(T, poses) < 15) & (near < bounds)).sum())


def small(repeats: int) -> tuple[dict[str, Any], str]:
    """256 pairs of 1,000 points in one call against the loop over single calls."""
    source, target = small_pairs(SMALL, SMALL_POINTS)
    pairs = source.unpack(), target.unpack()
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
    """The highest of the peaks of ``repeats`` processes of their own."""
    peaks = {name: [peak_bytes(*code)["bytes"] for _ in range(repeats)] for name, code in PEAKS.items()}
    rows = [[name, f"{max(several) / 2**30:.2f} GiB"] for name, several in peaks.items()]
    return peaks, table(["peak memory, above imports and clouds", ""], rows)


def geometry(options: tr.RegistrationOptions, confidence: float) -> tr.RegistrationOptions:
    """The plain procedure on FPFH alone, which Open3D does too."""
    solver = tr.RansacOptions(confidence=confidence, inlier_threshold=options.inlier_threshold)
    return replace(options.without_color(), effort="plain", solver=solver)


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
            (alone.fitness, together.fitness[b : b + 1]),
        ]
        if together.probability is not None and together.information is not None:
            pieces.append((alone.probability, together.probability[b : b + 1]))
            pieces.append((alone.information[0], together.information[b]))
        if not all(same(one, other) for one, other in pieces) or alone.reason[0] != together.reason[b]:
            return False
    return True


def same(one: Tensor, other: Tensor) -> bool:
    return torch.equal(one.nan_to_num(12345.0), other.nan_to_num(12345.0))


if __name__ == "__main__":
    main()
