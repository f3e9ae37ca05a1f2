"""``torchreg batch``: register all pairs of a list, resumable."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from torchreg.batch import Bounds, Engine, Pair, Store, pairs_of_file, pairs_of_glob
from torchreg.batch import run as run_batch
from torchreg.batch.described_file import computing_versions
from torchreg.batch.rows import RETRIED, export
from torchreg.batch.summary import summarize
from torchreg.cli import options as opt
from torchreg.cli.expand import expanded
from torchreg.cli.guard import NOT_REGISTERED, complain
from torchreg.cli.output import standard_output, write_json
from torchreg.cli.progress import batch_progress
from torchreg.cli.work import Work
from torchreg.declaration import declared
from torchreg.errors import expect_in_words, positive
from torchreg.settings import PairSettings

_LISTED_FILES = 20  # that do not exist, by name


@dataclass(frozen=True, kw_only=True)
class PairList:
    """The pairs of a batch, and when one with a truth counts as found."""

    pairs: Annotated[
        Path | None,
        typer.Argument(
            metavar="[PAIRS]",
            show_default=False,
            help="A table of pairs (.csv) with the columns source and target, file names relative to its folder. "
            "Further columns: name, truth (a file or sixteen numbers), and any of these settings for that pair alone: "
            f"{', '.join(declared(PairSettings))}. Or a list (.json): under pairs, objects with the same names, the "
            "truth as four rows of four numbers under T.",
        ),
    ] = None
    all_pairs: Annotated[
        str | None,
        typer.Option(
            "--all-pairs",
            metavar="PATTERN",
            help="Instead of a table, every two of the files that this pattern names, such as 'scans/*.ply'.",
            rich_help_panel=opt.INPUT,
        ),
    ] = None
    recall_degrees: Annotated[
        float,
        typer.Option(
            "--recall-degrees",
            metavar="DEGREES",
            min=0,
            help="Rotation error in degrees below which a pair with a truth counts as found.",
            rich_help_panel=opt.INPUT,
        ),
    ] = 15.0
    recall_meters: Annotated[
        float | None,
        typer.Option(
            "--recall-meters",
            metavar="METERS",
            min=0,
            help="Translation error in meters below which it counts as found; by default four inlier thresholds.",
            rich_help_panel=opt.INPUT,
        ),
    ] = None

    @property
    def bounds(self) -> Bounds:
        """When a pair counts as found.

        Raises:
            ValueError: an error that is no finite number above 0.
        """
        if self.recall_meters is not None:
            positive(self.recall_meters, "--recall-meters")
        return Bounds(positive(self.recall_degrees, "--recall-degrees"), self.recall_meters)

    def read(self, settings: PairSettings) -> tuple[Pair, ...]:
        """The pairs of the table, the list or the pattern.

        Raises:
            ValueError: both or neither are given, or one that names no pairs.
        """
        if self.pairs is not None and self.all_pairs is None:
            return pairs_of_file(self.pairs, settings)
        both = "neither" if self.pairs is None else "both"
        expect_in_words(self.pairs is None and self.all_pairs is not None, "PAIRS", "a pairs file or --all-pairs", both)
        return pairs_of_glob(self.all_pairs or "", settings)


@expanded
def batch(
    pairs: PairList,
    settings: PairSettings,
    work: Work,
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            metavar="FOLDER",
            help="Folder of the results, made if need be; an unfinished run there is resumed.",
            rich_help_panel=opt.OUTPUT,
        ),
    ],
) -> None:
    """Register every pair of PAIRS, a table or a list with source and target, and keep each as soon as it is done.

    The same command resumes a run that was cut off: no finished pair is lost or computed again. All lengths are in
    meters.

    FOLDER holds results.csv, results.json and results.parquet, summary.json, times.csv, and pairs/NAME.json for each.

    Exit code 0: every pair has its result, registered or refused. 2: bad usage. 3: some pairs have none, for
    example because a cloud could not be read; the same command tries these again.
    """
    opt.use(work.device, None)
    bounds = pairs.bounds
    work.check()
    listed = pairs.read(settings)
    manifest = {**computing_versions(), "device": work.device.value, **settings.flat(), "recall": list(bounds)}
    with closing(work.start()) as engine, Store(out, manifest) as store:
        _run(listed, store, engine, work, bounds)
        broken = _finish(listed, store)
    if broken:
        raise typer.Exit(NOT_REGISTERED)


def _run(pairs: tuple[Pair, ...], store: Store, engine: Engine, work: Work, bounds: Bounds) -> None:
    described = work.folder(store.folder)
    finished = {name for name, row in store.finished().items() if row.state not in RETRIED}
    files = {path for pair in pairs if pair.name not in finished for path in (pair.source, pair.target)}
    missing = sorted(path for path in files if not Path(path).exists())
    for path in missing[:_LISTED_FILES]:
        complain(f"{path}: no such file; its pairs fail")
    if len(missing) > _LISTED_FILES:
        complain(f"and {len(missing) - _LISTED_FILES} more files that do not exist")
    with batch_progress() as report:
        try:
            counts = run_batch(
                pairs, store, engine, described=described, bounds=bounds, max_bytes=work.max_bytes, report=report
            )
        except KeyboardInterrupt:
            done = f"{len(store.finished()):,} of {len(pairs):,} pairs are finished and kept in {store.folder}"
            complain(f"{done}; the same command resumes from there")
            raise
    for damage in store.damaged:
        complain(f"{damage} (the row is left out, and made again where it is needed)")
    if counts.before:
        complain(f"{counts.before:,} pairs were finished before")
    if counts.described or counts.reused:
        complain(f"{counts.described:,} clouds were described, {counts.reused:,} descriptions were there already")
    if counts.changed:
        complain(f"{counts.changed:,} finished pairs have other clouds or lengths now and were registered again")


def _finish(pairs: tuple[Pair, ...], store: Store) -> int:
    """Write the tables and show the summary; returns how many pairs have no result."""
    from torchreg.report import summary_table

    store.mend_records(pairs)
    rows = store.finished()
    lines = [rows[pair.name].line for pair in pairs]
    seconds = [rows[pair.name].seconds for pair in pairs]
    export(store.folder, lines, seconds)
    summary = summarize(lines, seconds, store.work())
    write_json(store.folder / "summary.json", summary.plain(), through_link=False)
    standard_output().print(summary_table(summary))
    return summary.unreadable + summary.broken
