"""One run over the pairs into a folder: measure what is missing, then write the tables."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from torchreg.benchmark.field.document import Findings, csv_text, markdown
from torchreg.benchmark.judge import judged
from torchreg.benchmark.machine import in_words, machine
from torchreg.benchmark.methods import METHODS, Method, Task, chosen_methods
from torchreg.benchmark.real_pairs import RealPair, read_real_pairs
from torchreg.benchmark.rows import Rows
from torchreg.errors import expect
from torchreg.io import read_cloud
from torchreg.io.atomic import atomic_write
from torchreg.preprocess import voxel_downsample
from torchreg.types import Clouds

Report = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Session:
    """What is to be run.

    Attributes:
        data: the list of pairs, or the folder that holds it.
        out: the folder of results; made where it is not there.
        methods: their names; ``None`` takes all.
        scenes: whose pairs are taken; ``None`` takes all.
        quick: of every scene, only the pair that overlaps most.
        device: where this library's own methods compute.
        seed: of every random draw and of the intervals.
    """

    data: Path
    out: Path
    methods: tuple[str, ...] | None = None
    scenes: tuple[str, ...] | None = None
    quick: bool = False
    device: str = "cpu"
    seed: int = 0

    def pairs(self) -> tuple[RealPair, ...]:
        """Those that are asked for.

        Raises:
            CloudFileError: the list cannot be read.
            ValueError: a scene that it does not have.
        """
        listed = read_real_pairs(self.data)
        known = list(dict.fromkeys(pair.scene for pair in listed))
        wanted = known if self.scenes is None else self.scenes
        for scene in wanted:
            expect(scene in known, "scenes", "scenes out of " + ", ".join(known), scene)
        chosen = tuple(pair for pair in listed if pair.scene in wanted)
        if not self.quick:
            return chosen
        most = {
            scene: max((p for p in chosen if p.scene == scene), key=lambda p: p.overlap)
            for scene in dict.fromkeys(pair.scene for pair in chosen)
        }
        return tuple(most.values())

    def run(self, report: Report = lambda _: None) -> Findings:
        """Measure what the folder does not hold yet, and write all files anew.

        Args:
            report: is told what is being done, in a few words.

        Returns:
            What was measured, now and before, as far as this session asks for it.

        Raises:
            ValueError: unknown names, or the folder holds results of other settings.
            CloudFileError: a file that cannot be read.
        """
        methods = chosen_methods(self.methods)
        pairs = self.pairs()
        self.out.mkdir(parents=True, exist_ok=True)
        facts = machine()
        rows = Rows(self.out, self._manifest(facts))
        gaps = {method.name: why for method in methods if (why := method.gap())}
        for name, why in gaps.items():
            report(f"{METHODS[name].title} is left out: {why}")
        here = [method for method in methods if method.name not in gaps]
        self._measure(pairs, here, rows, report)
        keys = [key_of(pair, method) for pair in pairs for method in methods]
        findings = Findings([rows[key] for key in keys if key in rows], methods, gaps, self.seed)
        self._write(findings, facts)
        return findings

    def _measure(self, pairs: Sequence[RealPair], methods: Sequence[Method], rows: Rows, report: Report) -> None:
        warm: set[str] = set()
        clouds: dict[Path, Clouds] = {}
        for number, pair in enumerate(pairs, start=1):
            missing = [method for method in methods if key_of(pair, method) not in rows]
            if not missing:
                continue
            for file in {*clouds} - {pair.source, pair.target}:
                del clouds[file]
            for file in (pair.source, pair.target):
                if file not in clouds:
                    clouds[file] = voxel_downsample(read_cloud(file), pair.voxel)
            task = Task(
                source=clouds[pair.source],
                target=clouds[pair.target],
                voxel=pair.voxel,
                seed=self.seed,
                device=self.device,
            )
            for method in missing:
                report(f"pair {number} of {len(pairs)}, {pair.name}: {method.title}")
                if method.name not in warm:
                    judged(method, _few_points(task), torch.eye(4, dtype=torch.float64))
                    warm.add(method.name)
                rows.add({**_facts(pair, method, task), **judged(method, task, pair.T_target_source)})

    def _write(self, findings: Findings, facts: dict[str, Any]) -> None:
        whole = {
            "machine": facts,
            "run": {**self._manifest(facts), "methods": [method.name for method in findings.methods]},
            "gaps": dict(findings.gaps),
            "rows": findings.rows,
        }
        last = f"{in_words(facts)}; torchreg's own methods on {self.device}."
        texts = {
            "field.md": markdown(findings, last),
            "field.csv": csv_text(findings),
            "field.json": json.dumps(whole, indent=1) + "\n",
        }
        for name, content in texts.items():
            with atomic_write(self.out / name) as file:
                file.write(content.encode())

    def _manifest(self, facts: dict[str, Any]) -> dict[str, Any]:
        """What every row depends on."""
        listed = self.data / "pairs.json" if self.data.is_dir() else self.data
        digest = hashlib.sha256(listed.read_bytes()).hexdigest()[:16]
        versions = {name: facts[name] for name in ("torchreg", "torch", "open3d")}
        return {**versions, "pairs": digest, "seed": self.seed, "device": self.device}


def key_of(pair: RealPair, method: Method) -> str:
    """The name of a row."""
    return f"{pair.name}/{method.name}"


def _facts(pair: RealPair, method: Method, task: Task) -> dict[str, Any]:
    return {
        "key": key_of(pair, method),
        "pair": pair.name,
        "scene": pair.scene,
        "overlap": pair.overlap,
        "voxel_m": pair.voxel,
        "points": [len(task.source.points), len(task.target.points)],
        "method": method.name,
        "version": method.version(),
    }


def _few_points(task: Task) -> Task:
    """The source onto itself at four times the voxel: what a first call alone takes is not counted."""
    cloud = voxel_downsample(task.source, 4 * task.voxel)
    return Task(source=cloud, target=cloud, voxel=4 * task.voxel, seed=task.seed, device=task.device)
