"""Descriptors beside the Point Cloud Library's: values on the same normals and neighborhoods, and times.

``python bench/reference.py values`` writes the values that tests compare with (``tests/descriptors/pcl/``);
``python bench/reference.py`` runs both libraries on a real scan of 10,000 points and writes
``bench/results/reference.json`` and the tables of ``docs/family.md``. The programs of ``bench/reference/`` must have
been built (its README.md says how), by default in ``build/reference``.
"""

from __future__ import annotations

import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from common import REAL, ROOT, bench_parser, in_words, machine, publish, save, table
from torch import Tensor

import torchreg as tr

VALUES = ROOT / "tests" / "descriptors" / "pcl"
COUNT = 10_000
SCAN = "redkitchen/frag_06.ply"
VOXEL, NEIGHBORS = 0.025, 1024


@dataclass(frozen=True, kw_only=True)
class Compared:
    """One descriptor of both libraries.

    Attributes:
        program: of ``bench/reference``.
        size: numbers of a row.
        ours: values (P, size) from a cloud, its neighborhoods and what the program wrote before the values (P, extra).
        options: of the program.
        extra: numbers that the program writes before the values of a row.
        unit: what the values are, for the table.
    """

    program: str
    size: int
    ours: Callable[[tr.Clouds, tr.Neighborhoods, Tensor], Tensor]
    options: tuple[str, ...] = ()
    extra: int = 0
    unit: str = "%"


COMPARED = {
    "pfh": Compared(program="pfh", size=125, ours=lambda cloud, near, extra: tr.pfh(cloud, near).values),
    "pfhrgb": Compared(program="pfhrgb", size=250, ours=lambda cloud, near, extra: tr.pfhrgb(cloud, near).values),
    "spin_images": Compared(
        program="spin_images",
        size=153,
        ours=lambda cloud, near, extra: tr.spin_images(cloud, near).values,
        unit="share",
    ),
    "spin_images, radial": Compared(
        program="spin_images",
        size=153,
        ours=lambda cloud, near, extra: tr.spin_images(cloud, near, support_cosine=0.5, structure="radial").values,
        options=("0.5", "radial"),
        unit="share",
    ),
    "spin_images, angles": Compared(
        program="spin_images",
        size=153,
        ours=lambda cloud, near, extra: tr.spin_images(cloud, near, content="angles").values,
        options=("0", "rectangular", "angles"),
        unit="radians",
    ),
    "shape_context": Compared(
        program="shape_context",
        size=1980,
        ours=lambda cloud, near, extra: tr.shape_context(cloud, near, frames=extra.view(-1, 3, 3), density=0.2).values,
        extra=9,
        unit="1 / m",
    ),
    "local_frames": Compared(
        program="local_frames",
        size=9,
        ours=lambda cloud, near, extra: tr.local_frames(cloud, near).flatten(1),
        unit="unit vectors",
    ),
    "local_frames, OMP": Compared(
        program="local_frames",
        size=9,
        ours=lambda cloud, near, extra: tr.local_frames(cloud, near).flatten(1),
        options=("omp",),
        unit="unit vectors",
    ),
    "shot": Compared(
        program="shot", size=352, ours=lambda cloud, near, extra: tr.shot(cloud, near).values, unit="unit length"
    ),
    "shot, OMP": Compared(
        program="shot",
        size=352,
        ours=lambda cloud, near, extra: tr.shot(cloud, near).values,
        options=("omp",),
        unit="unit length",
    ),
    "cshot": Compared(
        program="cshot", size=1344, ours=lambda cloud, near, extra: tr.cshot(cloud, near).values, unit="unit length"
    ),
    "cshot, PCL's table of colors, OMP": Compared(
        program="cshot",
        size=1344,
        ours=lambda cloud, near, extra: tr.cshot(cloud, near, values=lab_of_pcl(cloud.colors)).values,
        options=("omp",),
        unit="unit length",
    ),
    "unique_shape_context": Compared(
        program="unique_shape_context",
        size=1960,
        ours=lambda cloud, near, extra: tr.unique_shape_context(cloud, near).values,
        unit="1 / m",
    ),
}


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("what", nargs="?", choices=("tables", "values"), default="tables")
    parser.add_argument("--programs", type=Path, default=ROOT / "build" / "reference", help="where they were built")
    parser.add_argument("--only", nargs="+", choices=tuple(COMPARED), default=tuple(COMPARED), help="these descriptors")
    parser.add_argument("--runs", type=int, default=3, help="of each, of which the fastest counts")
    words = parser.parse_args()
    if words.what == "values":
        write_values(words.programs, words.only)
    else:
        write_tables(words.programs, words.only, words.runs, documents=not words.no_docs)


def write_values(programs: Path, only: tuple[str, ...]) -> None:
    """The cloud of the tests as text, and a file of PCL's values for each descriptor."""
    VALUES.mkdir(exist_ok=True)
    cloud, radius = small_cloud(), 0.5
    write_cloud(VALUES / "cloud.txt", cloud)
    for name in only:
        theirs = run_pcl(programs, COMPARED[name], VALUES / "cloud.txt", radius)
        np.savez_compressed(
            VALUES / f"{name.replace(', ', '_')}.npz", values=theirs.values.numpy(), extra=theirs.extra.numpy()
        )


def small_cloud() -> tr.Clouds:
    """A wavy sheet of 160 points with colors of 8 bits, some of them black, and normals; a point of it twice."""
    g = torch.Generator().manual_seed(5)
    xy = 2 * torch.rand(159, 2, generator=g)
    points = torch.cat([xy, 0.4 * torch.sin(2 * xy[:, :1]) * torch.cos(1.5 * xy[:, 1:])], dim=1)
    points = torch.cat([points, points[:1]])
    colors = torch.randint(0, 256, (160, 3), generator=g) / 255
    colors[::7] = torch.tensor([30.0, 50, 150]) / 255  # ratios of 3 : 5 and 1 : 5
    colors[::11] = 0
    cloud = tr.Clouds(points=points, colors=colors)
    return tr.estimate_normals(cloud, tr.neighbors(cloud, 0.5, 30))


def write_cloud(path: Path, cloud: tr.Clouds) -> None:
    colors = (cloud.colors * 255).round()
    rows = torch.cat([cloud.points, cloud.normals, colors], dim=1).numpy()
    np.savetxt(path, rows, fmt="%.9g")


def read_cloud(path: Path) -> tr.Clouds:
    points, normals, colors = torch.from_numpy(np.loadtxt(path, dtype=np.float32)).split(3, dim=1)
    return tr.Clouds(points=points.contiguous(), normals=normals.contiguous(), colors=(colors / 255).contiguous())


@dataclass(frozen=True)
class Theirs:
    """What a program of PCL gave."""

    values: Tensor  # (P, D)
    extra: Tensor  # (P, E)
    seconds: list[float]
    processor: list[float]  # seconds that all threads worked


def run_pcl(
    programs: Path, compared: Compared, path: Path, radius: float, *, threads: int = 1, runs: int = 1
) -> Theirs:
    """Run a program on a cloud; ``SystemExit`` where it is not there or fails."""
    with tempfile.TemporaryDirectory() as folder:
        values = Path(folder) / "values.bin"
        command = [programs / compared.program, path, repr(radius), values, str(threads), str(runs), *compared.options]
        try:
            done = subprocess.run(list(map(str, command)), check=True, capture_output=True, text=True)
        except FileNotFoundError:
            raise SystemExit(f"no {command[0]}: bench/reference/README.md says how to build it") from None
        except subprocess.CalledProcessError as error:
            raise SystemExit(f"{command[0]}: {error.stderr}") from error
        rows = torch.from_numpy(np.fromfile(values, np.float32)).view(-1, compared.extra + compared.size)
    wall, busy = done.stdout.split("seconds")[1].split("processor")
    seconds, processor = ([float(word) for word in part.split()] for part in (wall, busy))
    return Theirs(rows[:, compared.extra :].contiguous(), rows[:, : compared.extra].contiguous(), seconds, processor)


def differences(ours: Tensor, theirs: Tensor) -> dict[str, float]:
    """How far rows lie apart, beside the largest entry of PCL's row."""
    known = torch.isfinite(theirs).all(dim=1)
    gap = (ours - theirs)[known].abs().amax(dim=1) / theirs[known].abs().amax(dim=1).clamp(min=1e-12)
    return {
        "rows": int(known.sum()),
        "within 1e-4": float((gap <= 1e-4).double().mean()),
        "median": float(gap.median()),
        "largest": float(gap.max()),
    }


def lab_of_pcl(colors: Tensor) -> Tensor:
    """L / 100, a / 120 and b / 120 (P, 3) of colors of 8 bits, as PCL has them: off a table of 4000 steps."""
    light = torch.where(colors > 0.04045, ((colors + 0.055) / 1.055) ** 2.4, colors / 12.92)
    rows = ((0.412453, 0.357580, 0.180423), (0.212671, 0.715160, 0.072169), (0.019334, 0.119193, 0.950227))
    weights = light.new_tensor(rows)
    white = light.new_tensor((0.95047, 1.0, 1.08883))
    steps = torch.arange(4000) / 4000
    table = torch.where(steps > 0.008856, steps ** (1 / 3), 7.87 * steps + 16 / 116)
    fx, fy, fz = table[((light @ weights.t() / white) * 4000).long().clamp(max=3999)].unbind(1)
    return torch.stack([1.16 * fy - 0.16, 500 / 120 * (fx - fy), 200 / 120 * (fy - fz)], dim=1)


def real_cloud() -> tr.Clouds:
    """10,000 points of a thinned real scan with their normals."""
    scan = tr.voxel_downsample(tr.read_cloud(REAL / SCAN), VOXEL)
    if len(scan.points) < COUNT:
        raise SystemExit(f"{SCAN} has {len(scan.points)} points at {VOXEL} m, too few")
    around = (scan.points - scan.points.median(dim=0).values).square().sum(dim=1)
    scan = scan.rows(around.argsort()[:COUNT].sort().values, torch.tensor([0, COUNT]))
    cloud = tr.estimate_normals(scan, tr.neighbors(scan, 2 * VOXEL, 30))
    return tr.Clouds(points=cloud.points, normals=cloud.normals, colors=(cloud.colors * 255).round() / 255)


def write_tables(programs: Path, only: tuple[str, ...], runs: int, *, documents: bool) -> None:
    radius = 5 * VOXEL
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cloud.txt"
        write_cloud(path, real_cloud())
        cloud = read_cloud(path)
        near = tr.neighbors(cloud, radius, NEIGHBORS)
        counts = near.counts().double()
        results: dict[str, Any] = {}
        for name in only:
            compared = COMPARED[name]
            theirs = run_pcl(programs, compared, path, radius, runs=runs)
            ours = compared.ours(cloud, near, theirs.extra)
            times = {
                "PCL": min(theirs.processor),
                "torchreg": our_seconds(compared, cloud, radius, theirs.extra, runs),
            }
            results[name] = {"unit": compared.unit, **differences(ours, theirs.values), "processor seconds": times}
            print(name, results[name], flush=True)
    content = {
        "scan": SCAN,
        "voxel_m": VOXEL,
        "radius_m": radius,
        "points": len(cloud.points),
        "neighbors": {"mean": float(counts.mean()), "largest": int(counts.max())},
        "descriptors": results,
        "machine": machine(),
    }
    save("reference", content)
    if documents:
        publish("family parity", in_table(content))


def our_seconds(compared: Compared, cloud: tr.Clouds, radius: float, extra: Tensor, runs: int) -> float:
    """Processor seconds of search and descriptor on one thread, as PCL's hold both; the least of some runs."""

    def run() -> float:
        begin = time.process_time()
        compared.ours(cloud, tr.neighbors(cloud, radius, NEIGHBORS).trimmed(), extra)
        return time.process_time() - begin

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        run()
        return min(run() for _ in range(runs))
    finally:
        torch.set_num_threads(before)


def in_table(content: dict[str, Any]) -> str:
    """The table of the document."""
    rows = []
    for name, result in content["descriptors"].items():
        seconds = result["processor seconds"]
        rows.append(
            [
                name,
                str(COMPARED[name].size),
                f"{result['within 1e-4']:.2%}",
                f"{result['median']:.0e}",
                f"{result['largest']:.1e}",
                f"{seconds['PCL']:.2f} s",
                f"{seconds['torchreg']:.2f} s",
            ]
        )
    heads = ["descriptor", "numbers", "rows within 1e-4", "median gap", "largest gap", "PCL", "torchreg"]
    near = content["neighbors"]
    text = (
        f"{content['points']:,} points of {content['scan']} at {content['voxel_m']} m, radius {content['radius_m']} m: "
        f"{near['mean']:.0f} neighbors on average, {near['largest']} at most. {in_words(content['machine'])}"
    )
    return f"{text}\n\n{table(heads, rows)}"


if __name__ == "__main__":
    main()
