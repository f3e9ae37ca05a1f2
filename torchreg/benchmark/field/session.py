"""One run over the pairs into a folder: measure what is missing, then write the tables."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torchreg.benchmark.field.criteria import MATCH_VOXELS
from torchreg.benchmark.field.document import Findings, csv_text, markdown
from torchreg.benchmark.machine import in_words, machine
from torchreg.benchmark.measure import Item, Report, key_of, measure
from torchreg.benchmark.peers import METHODS, chosen_methods
from torchreg.benchmark.real_pairs import RealPair, read_real_pairs
from torchreg.benchmark.rows import Rows
from torchreg.errors import expect
from torchreg.io import read_cloud
from torchreg.io.atomic import atomic_write


@dataclass(frozen=True, kw_only=True)
class Session:
    """What is to be run.

    Attributes:
        data: the list of pairs, or the folder that holds it.
        out: the folder of results; made where it is not there.
        methods: their names; ``None`` takes all.
        scenes: whose pairs are taken; ``None`` takes all.
        quick: of every scene, only the pair that overlaps most; slow methods only where they are named.
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
        expect(len(wanted) > 0, "scenes", "at least one", wanted)
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
        methods = chosen_methods(self.methods, quick=self.quick)
        pairs = self.pairs()
        self.out.mkdir(parents=True, exist_ok=True)
        facts = machine()
        rows = Rows(self.out, self._manifest(facts))
        gaps = {method.name: why for method in methods if (why := method.gap())}
        for name, why in gaps.items():
            report(f"{METHODS[name].title} is left out: {why}")
        here = [method for method in methods if method.name not in gaps]
        items = [_item(pair) for pair in pairs]
        measure(items, here, rows, seed=self.seed, device=self.device, report=report)
        keys = [key_of(item, method) for item in items for method in methods]
        findings = Findings([rows[key] for key in keys if key in rows], methods, gaps, self.seed)
        self._write(findings, facts)
        return findings

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


def _item(pair: RealPair) -> Item:
    return Item(
        name=pair.name,
        facts={"scene": pair.scene, "overlap": pair.overlap},
        read=lambda: (read_cloud(pair.source), read_cloud(pair.target)),
        voxel=pair.voxel,
        near=MATCH_VOXELS * pair.voxel,
        T_true=pair.T_target_source,
    )
