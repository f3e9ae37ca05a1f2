"""One measurement as a record, and its runner: measure the rows that are missing, then write all files anew."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from torchreg.benchmark.core.machine import in_words, machine
from torchreg.benchmark.core.rows import Row, Rows
from torchreg.benchmark.core.tables import Table
from torchreg.io.atomic import write_text

Report = Callable[[str], None]
"""Takes one line of progress."""


class Picture(NamedTuple):
    """A file beside the document, the section it belongs to, and what it shows."""

    section: object
    file: str
    caption: str

    @property
    def markdown(self) -> str:
        """The picture, and its caption below it."""
        return f"![{self.caption}]({self.file})\n\n{self.caption}"


class Cell(NamedTuple):
    """One row to measure.

    Attributes:
        key: the row's name, different for every row of a study.
        label: the same for a reader.
        measure: returns the row without its key; ``None`` where it cannot be measured here, and only a row of an
            earlier run is shown.
    """

    key: str
    label: str
    measure: Callable[[], Row] | None


@dataclass(frozen=True, eq=False, kw_only=True)
class Study:
    """What is measured, and what is written of it.

    Attributes:
        name: of the files, NAME.md and NAME.json.
        cells: the rows, in the order of the files.
        settings: what every row depends on; rows of other settings are refused.
        versions: the facts of ``machine`` that every row depends on too.
        run: further facts of the run for the JSON file.
        document: the Markdown document, from rows, pictures, and a line about the machine.
        content: what the JSON file holds, from rows.
        csv: CSV files by name, from rows.
        draw: draws pictures into a folder, from rows.
        shown: what a terminal shows, tables and sentences, from rows.
        remarks: lines of progress before the first measurement.
        device: where torchreg computes, as PyTorch names it.
    """

    name: str
    cells: Sequence[Cell]
    settings: Mapping[str, Any]
    versions: tuple[str, ...] = ("torchreg", "torch", "open3d")
    run: Mapping[str, Any] = field(default_factory=dict)
    document: Callable[[list[Row], Sequence[Picture], str], str]
    content: Callable[[list[Row]], dict[str, Any]] = lambda rows: {"rows": rows}
    csv: Callable[[list[Row]], Mapping[str, str]] = lambda _: {}
    draw: Callable[[list[Row], Path], Iterable[Picture]] = lambda *_: ()
    shown: Callable[[list[Row]], Sequence[Table | str]]
    remarks: Sequence[str] = ()
    device: str = "cpu"


def run_study(study: Study, out: Path, report: Report = lambda _: None) -> list[Row]:
    """Measure what a folder does not hold yet, and write all files anew.

    Args:
        study: what is measured.
        out: the folder of results, made where it is missing. An unfinished run there is resumed.
        report: takes lines of progress.

    Returns:
        The rows of the study, measured now or before.

    Raises:
        ValueError: the folder holds rows of other settings.
        CloudFileError: a file that cannot be read.
    """
    out.mkdir(parents=True, exist_ok=True)
    facts = machine()
    manifest = {**{name: facts[name] for name in study.versions}, **study.settings}
    kept = Rows(out, manifest)
    for remark in study.remarks:
        report(remark)
    for number, cell in enumerate(study.cells, start=1):
        if cell.measure is not None and cell.key not in kept:
            report(f"{number} of {len(study.cells)}: {cell.label}")
            kept.add({"key": cell.key, **cell.measure()})
    rows = [kept[cell.key] for cell in study.cells if cell.key in kept]
    pictures = list(study.draw(rows, out))
    whole = {"machine": facts, "run": {**manifest, **study.run}, **study.content(rows)}
    files = {
        f"{study.name}.md": study.document(rows, pictures, f"{in_words(facts)}; torchreg on {study.device}."),
        f"{study.name}.json": json.dumps(whole, indent=1) + "\n",
        **study.csv(rows),
    }
    for name, text in files.items():
        write_text(out / name, text)
    return rows
