"""One run of the paper's experiments into a folder: measure what is missing, then write tables and pictures."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from torchreg.benchmark.machine import in_words, machine
from torchreg.benchmark.paper.document import Findings, csv_files, markdown
from torchreg.benchmark.paper.methods import METHODS
from torchreg.benchmark.paper.pictures import draw
from torchreg.benchmark.paper.places import MALL, Place, real_places, simulated_places
from torchreg.benchmark.paper.run import key_of, measure
from torchreg.benchmark.paper.settings import EXPERIMENTS, settings_of
from torchreg.benchmark.paper.size import FULL, QUICK
from torchreg.benchmark.paper.times import measure_times, time_key
from torchreg.benchmark.rows import Rows
from torchreg.errors import expect
from torchreg.io.atomic import atomic_write

Report = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Session:
    """What is to be run.

    Attributes:
        out: the folder of results; made where it is not there.
        experiments: of 1 to 5, at least one.
        seeds: simulated halls and roads, a count.
        seed: of the first of them.
        real: a list of real pairs or the folder of one, or ``None`` for the simulated scans alone.
        quick: small sizes, one real pair of each kind.
        device: where to compute, as PyTorch names it.
    """

    out: Path
    experiments: tuple[int, ...] = EXPERIMENTS
    seeds: int = 10
    seed: int = 0
    real: Path | None = None
    quick: bool = False
    device: str = "cpu"

    def __post_init__(self) -> None:
        expect(len(self.experiments) > 0, "experiments", "at least one", self.experiments)
        for number in self.experiments:
            expect(number in EXPERIMENTS, "experiments", "numbers from 1 to 5", number)

    def places(self) -> tuple[Place, ...]:
        """Every pair of scans that the experiments need, the paper's kind first."""
        size = QUICK if self.quick else FULL
        simulated = simulated_places(self.seed, self.seeds, angular_step=size.angular_step, variants=size.variants)
        real = () if self.real is None else real_places(self.real, self.seed)
        if self.quick:
            real = tuple({place.group.name: place for place in reversed(real)}.values())
        kinds = {setting.outdoor for number in self.experiments for setting in settings_of(number)}
        kinds |= {False} if 4 in self.experiments else set()
        return tuple(place for place in (*simulated, *real) if place.group.outdoor in kinds)

    def run(self, report: Report = lambda _: None) -> Findings:
        """Measure what the folder does not hold yet, and write all files anew.

        Args:
            report: is told what is being done, in a few words.

        Returns:
            What was measured, now and before, as far as this session asks for it.

        Raises:
            ValueError: the folder holds results of other settings.
            CloudFileError: a file that cannot be read.
        """
        places = self.places()
        self.out.mkdir(parents=True, exist_ok=True)
        facts = machine()
        rows = Rows(self.out, self._manifest(facts))
        settings = [setting for number in self.experiments for setting in settings_of(number)]
        size = QUICK if self.quick else FULL
        measure(places, settings, rows, size, torch.device(self.device), report)
        timed = next((place for place in places if place.group is MALL), None)
        if 4 in self.experiments and timed is not None:
            report("times")
            measure_times(timed, rows, size, torch.device(self.device))
        keys = [
            key_of(setting, place, method)
            for place in places
            for setting in settings
            if setting.outdoor == place.group.outdoor
            for method in METHODS
        ]
        times = []
        if 4 in self.experiments and timed is not None:
            times = [rows[time_key(setting.name, timed)] for setting in settings_of(3)]
        findings = Findings([rows[key] for key in keys], times, self.quick)
        report("tables and pictures")
        self._write(findings, places, facts)
        return findings

    def _write(self, findings: Findings, places: Sequence[Place], facts: dict[str, Any]) -> None:
        size = QUICK if self.quick else FULL
        pictures = list(draw(self.out, findings, places, self.experiments, size))
        text = markdown(findings, f"{in_words(facts)}, on {self.device}.", pictures)
        whole = {
            "machine": facts,
            "run": {"experiments": self.experiments, "seeds": self.seeds, **self._manifest(facts)},
            "errors": findings.errors,
            "times": findings.times,
        }
        files = {"paper.md": text, "paper.json": json.dumps(whole, indent=1) + "\n", **csv_files(findings)}
        for name, content in files.items():
            with atomic_write(self.out / name) as file:
                file.write(content.encode())

    def _manifest(self, facts: dict[str, Any]) -> dict[str, Any]:
        """What every row depends on."""
        versions = {name: facts[name] for name in ("torchreg", "torch")}
        return {**versions, "seed": self.seed, "quick": self.quick, "device": self.device}
