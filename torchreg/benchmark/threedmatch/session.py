"""One run over a folder of fragments: measure what is missing, then write the tables."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torchreg.benchmark.machine import in_words, machine
from torchreg.benchmark.measure import Item, Report, key_of, measure
from torchreg.benchmark.peers import METHODS, chosen_methods
from torchreg.benchmark.rows import Rows
from torchreg.benchmark.threedmatch.document import Findings, csv_text, markdown
from torchreg.benchmark.threedmatch.protocol import NEAR
from torchreg.datasets import Fragments
from torchreg.errors import expect
from torchreg.io.atomic import atomic_write
from torchreg.types import Clouds


@dataclass(frozen=True, kw_only=True)
class Session:
    """What is to be run.

    Attributes:
        folder: a scene, or a folder of scenes, as ``Fragments`` takes it.
        out: the folder of results; made where it is not there.
        log: which log, as ``Fragments`` takes it.
        methods: their names; ``None`` takes all.
        scenes: folders whose pairs are taken; ``None`` takes all.
        voxel: meters, what all clouds are averaged over.
        quick: only the first pair of every scene whose fragments do not follow one another; slow methods only where
            they are named.
        device: where this library's own methods compute.
        seed: of every random draw and of the intervals.
    """

    folder: Path
    out: Path
    log: Path | None = None
    methods: tuple[str, ...] | None = None
    scenes: tuple[str, ...] | None = None
    voxel: float = 0.05
    quick: bool = False
    device: str = "cpu"
    seed: int = 0

    def items(self) -> tuple[Item, ...]:
        """The pairs that are asked for.

        Raises:
            CloudFileError: what ``Fragments`` refuses.
            ValueError: a scene that is not there.
        """
        dataset = Fragments(self.folder, log=self.log)
        known = list(dict.fromkeys(dataset.scenes))
        wanted = known if self.scenes is None else self.scenes
        expect(len(wanted) > 0, "scenes", "at least one", wanted)
        for scene in wanted:
            expect(scene in known, "scenes", "scenes out of " + ", ".join(known), scene)
        chosen = [_item(dataset, k, self.voxel) for k, scene in enumerate(dataset.scenes) if scene in wanted]
        if not self.quick:
            return tuple(chosen)
        apart = [item for item in chosen if item.facts["j"] - item.facts["i"] > 1]
        return tuple({item.facts["scene"]: item for item in reversed(apart)}.values())[::-1]

    def run(self, report: Report = lambda _: None) -> Findings:
        """Measure what the folder of results does not hold yet, and write all files anew.

        Args:
            report: is told what is being done, in a few words.

        Returns:
            What was measured, now and before, as far as this session asks for it.

        Raises:
            ValueError: unknown names, or the folder holds results of other settings.
            CloudFileError: a file that cannot be read.
        """
        methods = chosen_methods(self.methods, quick=self.quick)
        items = self.items()
        self.out.mkdir(parents=True, exist_ok=True)
        facts = machine()
        rows = Rows(self.out, self._manifest(facts))
        gaps = {method.name: why for method in methods if (why := method.gap())}
        for name, why in gaps.items():
            report(f"{METHODS[name].title} is left out: {why}")
        here = [method for method in methods if method.name not in gaps]
        measure(items, here, rows, seed=self.seed, device=self.device, report=report)
        keys = [key_of(item, method) for item in items for method in methods]
        findings = Findings([rows[key] for key in keys if key in rows], methods, gaps, self.voxel, self.seed)
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
            "3dmatch.md": markdown(findings, last),
            "3dmatch.csv": csv_text(findings),
            "3dmatch.json": json.dumps(whole, indent=1) + "\n",
        }
        for name, content in texts.items():
            with atomic_write(self.out / name) as file:
                file.write(content.encode())

    def _manifest(self, facts: dict[str, Any]) -> dict[str, Any]:
        """What every row depends on."""
        versions = {name: facts[name] for name in ("torchreg", "torch", "open3d")}
        places = {"folder": os.path.abspath(self.folder), "log": None if self.log is None else str(self.log)}
        chosen = {"voxel": self.voxel, "seed": self.seed, "device": self.device}
        return {**versions, **places, "truth": _truth(Fragments(self.folder, log=self.log)), **chosen}


def _truth(dataset: Fragments) -> str:
    """A digest of all poses and information matrices: rows measured against others are not taken for these."""
    digest = hashlib.sha256()
    for k, name in enumerate(dataset.names):
        digest.update(name.encode())
        digest.update(dataset.T_target_source[k].numpy().tobytes())
        if dataset.information is not None:
            digest.update(dataset.information[k].numpy().tobytes())
    return digest.hexdigest()[:16]


def _item(dataset: Fragments, k: int, voxel: float) -> Item:
    i, j = dataset.numbers[k]

    def read() -> tuple[Clouds, Clouds]:
        return dataset.reader.read(dataset.sources[k]), dataset.reader.read(dataset.targets[k])

    information = None if dataset.information is None else dataset.information[k]
    if information is not None and bool(information.isnan().all()):
        information = None
    return Item(
        name=dataset.names[k],
        facts={"scene": dataset.scenes[k], "i": i, "j": j},
        read=read,
        voxel=voxel,
        near=NEAR,
        T_true=dataset.T_target_source[k],
        information=information,
    )
