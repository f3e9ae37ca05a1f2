"""``tr.verify`` on the real pairs beside the checkout: how many true and wrong transforms are held to be right.

    python bench/given_transforms.py

Every pair is judged under its true transform, under that one displaced in several ways, and under the true transform of
another pair; ``register`` runs beside it for the time. Written: bench/results/given_transforms.json and the table of
docs/benchmarks/verdict.md.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from typing import Any

import torch
from common import REAL, bench_parser, in_words, machine, publish, save, table
from torch import Tensor

import torchreg as tr
from torchreg.benchmark.core.real_pairs import RealPair, read_real_pairs
from torchreg.geometry.se3 import compose, rigid
from torchreg.preprocess import voxel_downsample

SEED = 0
SMALL, LARGE, TURN = 0.5, 5.0, 10.0  # voxels, voxels, degrees


def main() -> None:
    arguments = bench_parser(__doc__).parse_args()
    pairs = read_real_pairs(REAL)
    rows: list[dict[str, Any]] = []
    for number, pair in enumerate(pairs):
        other = pairs[(number + 1) % len(pairs)]
        rows += judged(pair, other, torch.Generator().manual_seed(number))
        print(*(f"{row['given']}: {row['reason'] or 'right'}" for row in rows[-len(GIVEN) :]), sep="\n", flush=True)
    content = {"machine": machine(), "rows": rows}
    save("given_transforms", content)
    text = f"{summary(rows)}\n\n{in_words(content['machine'])}."
    print(text)
    if not arguments.no_docs:
        publish("given transforms", text)


def judged(pair: RealPair, other: RealPair, generator: torch.Generator) -> list[dict[str, Any]]:
    """A row for every given transform of one pair."""
    source, target = (voxel_downsample(tr.read_cloud(path), pair.voxel) for path in (pair.source, pair.target))
    options = tr.options_for(pair.voxel, colored=source.colors is not None and target.colors is not None)
    middle = target.points.double().mean(dim=0) + target.origin[0]
    begun = time.perf_counter()
    registered = tr.register(source, target, options, seed=SEED)
    seconds = time.perf_counter() - begun
    rows = []
    for name, move in GIVEN.items():
        T = move(pair, other, middle, generator)
        begun = time.perf_counter()
        result = tr.verify(source, target, T, options, seed=SEED)
        rows.append(
            {
                "pair": pair.name,
                "given": name,
                "seconds": time.perf_counter() - begun,
                "register_seconds": seconds,
                "registered": bool(registered.success[0]),
                "success": bool(result.success[0]),
                "probability": float(result.probability[0]),
                "deviation_voxels": float(result.deviation_meters[0]) / pair.voxel,
                "deviation_degrees": float(result.deviation_degrees[0]),
                "kind": "" if result.failure[0] is None else result.failure[0].kind,
                "reason": result.reason[0],
            }
        )
    return rows


Move = Callable[[RealPair, RealPair, Tensor, torch.Generator], Tensor]


def shifted(voxels: float) -> Move:
    """The true transform, and a shift in any direction."""

    def move(pair: RealPair, _: RealPair, middle: Tensor, generator: torch.Generator) -> Tensor:
        shift = voxels * pair.voxel * direction(generator)
        return compose(rigid(torch.eye(3, dtype=torch.float64), shift), pair.T_target_source)

    return move


def turned(pair: RealPair, _: RealPair, middle: Tensor, generator: torch.Generator) -> Tensor:
    """The true transform, and a turn about any axis through the middle of the target."""
    return compose(turn(direction(generator), TURN, middle), pair.T_target_source)


def half_turned(pair: RealPair, _: RealPair, middle: Tensor, generator: torch.Generator) -> Tensor:
    """The true transform, and a half turn about what is about vertical in the frame of a camera (y) or a laser (z)."""
    up = torch.tensor([0.0, 1.0, 0.0] if pair.colored else [0.0, 0.0, 1.0], dtype=torch.float64)
    return compose(turn(up, 180.0, middle), pair.T_target_source)


GIVEN: dict[str, Move] = {
    "the true transform": lambda pair, other, middle, generator: pair.T_target_source,
    f"shifted by {SMALL:g} voxels": shifted(SMALL),
    f"shifted by {LARGE:g} voxels": shifted(LARGE),
    f"turned by {TURN:g} degrees": turned,
    "turned by 180 degrees": half_turned,
    "of another pair": lambda pair, other, middle, generator: other.T_target_source,
}


def direction(generator: torch.Generator) -> Tensor:
    return torch.nn.functional.normalize(torch.randn(3, dtype=torch.float64, generator=generator), dim=0)


def turn(axis: Tensor, degrees: float, middle: Tensor) -> Tensor:
    """A turn about an axis through a point: (4, 4)."""
    x, y, z = axis.tolist()
    cross = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    R = torch.linalg.matrix_exp(math.radians(degrees) * cross)
    return rigid(R, middle - R @ middle)


def summary(rows: list[dict[str, Any]]) -> str:
    """The table: a row per kind of given transform."""
    lines = []
    for name in GIVEN:
        of = [row for row in rows if row["given"] == name]
        kinds = [row["kind"] for row in of if row["kind"]]
        reasons = ", ".join(f"{kind} {kinds.count(kind)}" for kind in sorted(set(kinds), key=kinds.count, reverse=True))
        ratio = statistics.median(row["seconds"] / row["register_seconds"] for row in of)
        right = sum(row["success"] for row in of)
        lines.append([name, f"{right} of {len(of)}", reasons or "-", f"{ratio:.2f}"])
    return table(["given", "held to be right", "else, by kind of failure", "time, relative to register"], lines)


if __name__ == "__main__":
    main()
