"""``torchreg batch``: register all pairs of a list, resumable."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from torchreg.cli import batch_options as own
from torchreg.cli import options as opt
from torchreg.cli.batch_progress import shown
from torchreg.cli.device import use
from torchreg.cli.expand import expanded
from torchreg.cli.guard import NOT_REGISTERED, complain
from torchreg.cli.output import standard_output
from torchreg.cli.overrides import Overrides
from torchreg.errors import expect, positive

if TYPE_CHECKING:
    from torchreg.batch import Bounds, Pair, PairSettings, Store
    from torchreg.batch.engines import Engine


@dataclass(frozen=True, kw_only=True)
class Work:
    """How a batch is computed; of this, the device alone may change the last bits of a result."""

    engine: own.EngineName = own.EngineKind.local
    ray_address: own.RayAddress = None
    workers: own.Workers = None
    cache: own.Cache = None
    max_bytes: own.MaxBytes = None
    device: opt.DeviceName = opt.Device.cpu

    def check(self) -> None:
        """See before anything begins that the folder of descriptions can be one."""
        if self.cache is not None:
            fits = self.cache.absolute().parent.is_dir() and (not self.cache.exists() or self.cache.is_dir())
            expect(fits, "--cache", "a folder, or a name for one in a folder that exists", str(self.cache))

    def start(self) -> Engine:
        """The engine that does the work."""
        address = self.ray_address
        ray = self.engine is own.EngineKind.ray
        expect(address is None or ray, "--ray-address", "--engine ray beside it", self.engine.value)
        if ray:
            from torchreg.batch.ray_engine import RayEngine

            return RayEngine(self.workers, address, self.device.value)
        from torchreg.batch.local_engine import LocalEngine

        return LocalEngine(self.workers, self.device.value)


@expanded
def batch(
    overrides: Overrides,
    work: Work,
    out: own.Out,
    pairs: own.PairsFile = None,
    all_pairs: own.AllPairs = None,
    scale: own.ScaleName = own.ScaleKind.shared,
    points: opt.Points = None,
    viewpoint: opt.ViewpointText = "auto",
    effort: opt.EffortName = None,
    solver: opt.SolverName = None,
    seed: opt.Seed = 0,
    recall_degrees: own.RecallDegrees = 15.0,
    recall_meters: own.RecallMeters = None,
) -> None:
    """Register every pair of PAIRS, a table with the columns source and target, and keep each as soon as it is done.

    The same command goes on where it was cut off: no pair is lost, none computed twice beyond those in hand. Further
    columns: name, truth (a file or sixteen numbers), and any of preset, scale, voxel, normal_radius, feature_radius,
    color_radius, inlier_threshold, hypotheses, confidence, no_color, effort, solver, seed, points, viewpoint for that
    pair alone; others are carried into the table.

    DIR holds results.csv, results.json and results.parquet, summary.json, times.csv, and pairs/NAME.json for each.

    Exit code 0: every pair has its result, registered or refused. 2: bad usage. 3: some pairs have none, since a cloud
    could not be read, say; the same command tries these again.
    """
    from torchreg.batch import Bounds, PairSettings, Store
    from torchreg.batch.described_file import computing_versions

    one_of_both = (pairs is None) != (all_pairs is None)
    expect(one_of_both, "PAIRS", "a pairs file or --all-pairs", "neither" if pairs is None else "both")
    use(work.device, None)
    settings = PairSettings(
        scale=scale.value,
        preset=overrides.preset.value,
        overrides=overrides.said(),
        effort=None if effort is None else effort.value,
        solver=None if solver is None else solver.value,
        seed=seed,
        points=points,
        viewpoint=viewpoint,
    )
    if recall_meters is not None:
        positive(recall_meters, "--recall-meters")
    positive(recall_degrees, "--recall-degrees")
    work.check()
    listed = _listed(pairs, all_pairs, settings)
    bounds = Bounds(recall_degrees, recall_meters)
    made = {**computing_versions(), "device": work.device.value}
    manifest = {**made, **settings.flat(), "recall": list(bounds)}
    with closing(work.start()) as engine, Store(out, manifest) as store:
        _run(listed, store, engine, work, bounds)
        broken = _finish(listed, store)
    if broken:
        raise typer.Exit(NOT_REGISTERED)


def _listed(pairs: Path | None, all_pairs: str | None, settings: PairSettings) -> tuple[Pair, ...]:
    from torchreg.batch import pairs_of_file, pairs_of_glob

    if pairs is not None:
        return pairs_of_file(pairs, settings)
    return pairs_of_glob(all_pairs or "", settings)


def _run(pairs: tuple[Pair, ...], store: Store, engine: Engine, work: Work, bounds: Bounds) -> None:
    """The batch itself, and what is to be said of it on the way."""
    from torchreg.batch import run
    from torchreg.batch.rows import RETRIED
    from torchreg.io.atomic import remove_remains

    described = (store.folder / "described" if work.cache is None else work.cache).absolute()
    described.mkdir(exist_ok=True)
    remove_remains(described, older_than=3600.0)
    finished = {name for name, row in store.finished().items() if row.state not in RETRIED}
    ends = {path for pair in pairs if pair.name not in finished for path in (pair.source, pair.target)}
    missing = sorted(path for path in ends if not Path(path).exists())
    for path in missing[:20]:
        complain(f"{path}: no such file; its pairs fail")
    if len(missing) > 20:
        complain(f"and {len(missing) - 20} more files that do not exist")
    with shown() as report:
        try:
            done = run(
                pairs, store, engine, described=described, bounds=bounds, max_bytes=work.max_bytes, report=report
            )
        except KeyboardInterrupt:
            complain(
                f"{store.count_finished():,} of {len(pairs):,} pairs are done with; the same command goes on from there"
            )
            raise
    if done.before:
        complain(f"{done.before:,} pairs were finished before")
    if done.described or done.reused:
        complain(f"{done.described:,} clouds were described, {done.reused:,} descriptions were there already")
    if done.changed:
        complain(f"{done.changed:,} finished pairs have other clouds or lengths now and were registered again")


def _finish(pairs: tuple[Pair, ...], store: Store) -> int:
    """Write the tables and show the summary; returns how many pairs have no result."""
    import json

    from torchreg.batch.export import export
    from torchreg.batch.summary import summarize
    from torchreg.io.atomic import atomic_write
    from torchreg.report import summary_table

    store.mend_records(pairs)
    rows = store.finished()
    lines = [rows[pair.name].line for pair in pairs]
    seconds = [rows[pair.name].seconds for pair in pairs]
    export(store.folder, lines, seconds)
    summary = summarize(lines, seconds, store.work())
    with atomic_write(store.folder / "summary.json") as file:
        file.write((json.dumps(summary.plain(), indent=2, allow_nan=False) + "\n").encode())
    standard_output().print(summary_table(summary))
    return summary.unreadable + summary.broken
