"""Super4PCS beside OpenGR, its authors' program, and beside ``register``, on every second real pair at 2,000 points.

    python bench/super4pcs.py --opengr PROGRAM         PROGRAM as built by bench/reference/opengr/README.md
    python bench/super4pcs.py                          without OpenGR
    python bench/super4pcs.py --saved                  the table from bench/results/super4pcs.json, nothing measured

A pair is found within 5 degrees and 6 voxels (those of the list, or of the thinned clouds where these are wider). Times
are seconds of one processor core, so that other programs on the machine do not count. Rows that were measured are kept
in build/super4pcs.json, and an unfinished run goes on from there. Written: bench/results/super4pcs.json and the table
in docs/super4pcs.md.
"""

from __future__ import annotations

import json
import os
import resource
import statistics
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import torch
from common import REAL, RESULTS, ROOT, bench_parser, in_words, listed_pairs, machine, publish, save, table

import torchreg as tr
from torchreg.benchmark.core.real_pairs import RealPair, read_real_pairs
from torchreg.registration.spacing import CloudScale

POINTS = 2000
DEGREES, VOXELS = 5.0, 6.0
OVERLAP = 0.4  # assumed by both searches
SECONDS = 60  # by the clock, that OpenGR may take
PARTIAL = ROOT / "build" / "super4pcs.json"
METHODS = {"super4pcs": "`tr.super4pcs`", "opengr": "OpenGR's Super4PCS", "register": "`tr.register`"}
GROUPS = (("overlap at least 0.6", 0.6, 1.1), ("0.35 to 0.6", 0.35, 0.6), ("below 0.35", 0.0, 0.35))


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("--opengr", type=Path, help="the program; without it OpenGR is left out")
    parser.add_argument("--saved", action="store_true", help="write the table from saved results, nothing measured")
    arguments = parser.parse_args()
    if arguments.saved:
        content = json.loads((RESULTS / "super4pcs.json").read_text())
    else:
        content: dict[str, Any] = {"machine": machine(), "rows": measured(arguments.opengr)}
        save("super4pcs", content)
    text = f"{summary(content['rows'])}\n\n{in_words(content['machine'])}."
    print(text)
    if not arguments.no_docs:
        publish("super4pcs", text)


def measured(program: Path | None) -> list[dict[str, Any]]:
    """A row per pair and method."""
    listed_pairs()
    rows: list[dict[str, Any]] = json.loads(PARTIAL.read_text()) if PARTIAL.exists() else []
    done = {(row["pair"], row["method"]) for row in rows}
    PARTIAL.parent.mkdir(exist_ok=True)
    pairs = read_real_pairs(REAL)[1::2]
    for pair in (*pairs[::3], *pairs[1::3], *pairs[2::3]):  # a run that is broken off has seen all scenes
        source, target, voxel = thinned(pair)
        for method in METHODS:
            if (pair.name, method) in done or (method == "opengr" and program is None):
                continue
            begin = processor_seconds()
            if method == "opengr":
                T, success = opengr(program, source, target), None
            else:
                result = (tr.super4pcs if method == "super4pcs" else tr.register)(source, target)
                T, success = result.T_target_source[0], bool(result.success)
            seconds = processor_seconds() - begin
            rre, rte = (float(error(pair.T_target_source, T)) for error in (tr.metrics.rre, tr.metrics.rte))
            found = rre < DEGREES and rte < VOXELS * voxel
            row = {"pair": pair.name, "overlap": pair.overlap, "method": method, "found": found, "success": success}
            rows.append({**row, "rre_deg": rre, "rte_m": rte, "voxel_m": voxel, "seconds": seconds})
            PARTIAL.write_text(json.dumps(rows, indent=1))
            print(rows[-1], flush=True)
    return rows


def thinned(pair: RealPair) -> tuple[tr.Clouds, tr.Clouds, float]:
    """Both clouds at the same voxels, the larger at about ``POINTS``, and the edge of the voxels."""
    clouds = [tr.read_cloud(str(file)) for file in (pair.source, pair.target)]
    voxel = max(pair.voxel, *(CloudScale(cloud, POINTS).thinning_voxel for cloud in clouds))
    source, target = (tr.voxel_downsample(cloud, voxel) for cloud in clouds)
    return source, target, voxel


def opengr(program: Path, source: tr.Clouds, target: tr.Clouds) -> torch.Tensor:
    """The transform that OpenGR finds, with normals and colors as its filters."""
    spacing = max(float(tr.spacing(cloud)) for cloud in (source, target))
    with tempfile.TemporaryDirectory() as folder:
        files = [str(Path(folder) / name) for name in ("source", "target")]
        for file, cloud in zip(files, (source, target), strict=True):
            cloud = tr.estimate_normals(cloud, tr.neighbors(cloud, 2 * spacing, 30))
            colors = -torch.ones_like(cloud.points) if cloud.colors is None else 255 * cloud.colors
            rows = torch.cat([cloud.points, cloud.normals, colors], dim=1).tolist()
            Path(file).write_text("".join(" ".join(f"{value:.7g}" for value in row) + "\n" for row in rows))
        given = (0.75 * spacing, OVERLAP, 500, 50, 0.5 * 255, SECONDS)
        run = subprocess.run([program, *files, *map(str, given)], capture_output=True, text=True, check=True)
    numbers = [[float(value) for value in line.split()] for line in run.stdout.splitlines()[-5:-1]]  # it logs before
    return torch.tensor(numbers, dtype=torch.float64)


def processor_seconds() -> float:
    """Of this process and of programs that it ran."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def summary(rows: list[dict[str, Any]]) -> str:
    """Pairs found by overlap, times, and wrong answers that were called right."""
    lines = []
    for method, title in METHODS.items():
        mine = [row for row in rows if row["method"] == method]
        if not mine:
            continue
        cells = [title, of(mine)]
        cells += [of([row for row in mine if low <= row["overlap"] < high]) for _, low, high in GROUPS]
        right = [row for row in mine if row["found"]]
        errors = [statistics.median(row[name] for row in right) if right else None for name in ("rre_deg", "rte_m")]
        cells.append("-" if errors[0] is None else f"{errors[0]:.2f} deg, {errors[1]:.3f} m")
        cells.append(f"{statistics.median(row['seconds'] for row in mine):.1f} s")
        judges = mine[0]["success"] is not None
        cells.append(str(sum(row["success"] and not row["found"] for row in mine)) if judges else "-")
        cells.append(str(sum(row["found"] and not row["success"] for row in mine)) if judges else "-")
        lines.append(cells)
    head = ["method", "pairs found", *(name for name, _, _ in GROUPS)]
    head += ["median errors", "median time", "wrong, called right", "right, refused"]
    return table(head, lines)


def of(rows: list[dict[str, Any]]) -> str:
    return f"{sum(row['found'] for row in rows)} of {len(rows)}"


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
