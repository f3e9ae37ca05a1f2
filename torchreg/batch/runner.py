"""A whole batch: measure every cloud, describe each once, register the pairs, and keep each as soon as it is done."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import torch

from torchreg.batch import plan
from torchreg.batch.engine import BatchProgress, Engine, Outcome, Report, stop_without_room
from torchreg.batch.finished import FinishedPair
from torchreg.batch.jobs import DESCRIBE, REGISTER, DescribeItem, PairItem, Slice
from torchreg.batch.pairs import Pair
from torchreg.batch.rows import RETRIED, Bounds, Row
from torchreg.batch.run_folder import differences
from torchreg.batch.store import Store
from torchreg.batch.survey import Survey, lengths_stand_alone, options_of_pairs, survey_clouds
from torchreg.entry import entry
from torchreg.errors import expect
from torchreg.io.result_json import plain_data
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.plan import budget


class RunCounts(NamedTuple):
    """How many pairs and clouds a run worked on.

    Attributes:
        before: pairs that were finished before and whose results are kept.
        now: pairs that were registered, or failed, in this run.
        described: clouds that were described in this run.
        reused: descriptions that were there already.
        changed: pairs of this run that had been finished with other clouds or lengths.

    Example:
        >>> from torchreg.batch import RunCounts
        >>> RunCounts(before=4, now=6, described=5, reused=3, changed=0).now
        6
    """

    before: int
    now: int
    described: int
    reused: int
    changed: int


@entry
def run(
    pairs: Sequence[Pair],
    store: Store,
    engine: Engine,
    *,
    described: Path,
    bounds: Bounds,
    max_bytes: int | None = None,
    report: Report = lambda _: None,
) -> RunCounts:
    """Register all pairs that are not finished yet; each is kept as soon as it is done.

    Args:
        pairs: of different names.
        store: where results go.
        engine: that does the work.
        described: the folder of descriptions, which exists; several batches may share it.
        bounds: when a pair with a truth counts as found.
        max_bytes: about what pairs that are registered together may hold, over all workers; ``None`` takes a quarter
            of the free memory. Describing takes what one cloud needs, in every worker.
        report: called at every step.

    Returns:
        RunCounts. The rows are in the store.

    Raises:
        ValueError: two pairs of one name, or a finished pair that was written differently then.
        OSError: nothing can be written any more; finished pairs are kept.

    Example:
        >>> import torchreg as tr
        >>> from pathlib import Path
        >>> from torchreg.batch import Bounds, LocalEngine, PairSettings, Store, pairs_of_file, run
        >>> scans = tr.datasets.mall(seed=1, angular_step=4.0)
        >>> tr.write_cloud("a.ply", scans.source)
        >>> tr.write_cloud("b.ply", scans.target)
        >>> _ = Path("pairs.csv").write_text("source,target\\na.ply,b.ply\\n")
        >>> Path("described").mkdir(exist_ok=True)
        >>> pairs = pairs_of_file(Path("pairs.csv"), PairSettings(effort="plain"))
        >>> bounds = Bounds(degrees=15.0, meters=0.3)
        >>> with Store(Path("results"), {}) as store:
        ...     counts = run(pairs, store, LocalEngine(0), described=Path("described"), bounds=bounds)
        >>> counts.now
        1
    """
    twice = [name for name, count in Counter(pair.name for pair in pairs).items() if count > 1]
    expect(not twice, "pairs", "a name of its own for every pair", twice)
    finished = store.finished()
    _expect_same_pairs(pairs, finished)
    share = max(1, budget(max_bytes, torch.device("cpu")) // engine.workers)
    survey = survey_clouds(pairs, store, engine, report)
    todo = _todo(pairs, finished, survey, store, engine, described, bounds)

    wanted = {side.file for item in todo.items for side in (item.source, item.target)}
    missing = plan.missing_descriptions(todo.items)
    lost = _describe(missing, len(wanted), store, engine, report)

    again = {pair.name for pair, _ in todo.failed} | {item.pair.name for item in todo.items}
    kept = [pair.name for pair in pairs if pair.name not in again]
    failures = sum(not finished[name].line["success"] for name in kept)
    tally = _Tally(store, BatchProgress("register", len(kept), len(pairs), failures), report)
    for pair, outcome in todo.failed:
        tally.fail(pair, outcome)
    left: list[PairItem] = []
    for item in todo.items:
        missed = lost.get(item.source.file) or lost.get(item.target.file)
        if missed is None:
            left.append(item)
        else:
            tally.fail(item.pair, missed)
    _register(left, engine, share, tally)
    return RunCounts(len(kept), len(again), len(missing) - len(lost), len(wanted) - len(missing), todo.changed)


class _Todo(NamedTuple):
    """Pairs to be registered, pairs that cannot be and why, and how many of the former were finished before with other
    clouds or lengths."""

    items: list[PairItem]
    failed: list[tuple[Pair, Outcome]]
    changed: int


def _todo(
    pairs: Sequence[Pair],
    finished: Mapping[str, FinishedPair],
    survey: Survey,
    store: Store,
    engine: Engine,
    described: Path,
    bounds: Bounds,
) -> _Todo:
    readable, failed = [], []
    settled = {name: row for name, row in finished.items() if row.state not in RETRIED}
    for pair in pairs:
        row, trouble = settled.get(pair.name), survey.trouble(pair)
        if trouble is not None:
            failed += [(pair, trouble)] if row is None else []
        elif row is None or not lengths_stand_alone(pair, survey) or row.digests != survey.digests_of(pair):
            readable.append(pair)
    options, lost = options_of_pairs(readable, survey, store, engine)
    items, stale = [], 0
    for pair in readable:
        row = settled.get(pair.name)
        if pair.name in lost:
            failed += [(pair, lost[pair.name])] if row is None else []
            continue
        text = _options_text(options[pair.name])
        if row is None or row.digests != survey.digests_of(pair) or row.options != text:
            measures = survey.measures_of(pair)
            items.append(plan.pair_item(pair, options[pair.name], measures, described, engine.device, bounds))
            stale += row is not None
    return _Todo(items, failed, stale)


def _expect_same_pairs(pairs: Sequence[Pair], finished: Mapping[str, FinishedPair]) -> None:
    """Refuse a pair whose finished row was written differently; one that failed may be corrected."""
    for pair in pairs:
        row = finished.get(pair.name)
        if row is None or row.state in RETRIED:
            continue
        different = differences(json.loads(row.text), json.loads(pair.text))
        if different:
            expected = "what it was when it was finished, or a new folder"
            raise ValueError(f"pair {pair.name}: expected {expected}, got {different}")


def _options_text(options: RegistrationOptions) -> str:
    """All options as one text that is compared."""
    return json.dumps(plain_data(options), sort_keys=True)


class _Tally:
    """Keeps rows as they come, counts and reports them."""

    def __init__(self, store: Store, progress: BatchProgress, report: Report) -> None:
        self._store, self._progress, self._report = store, progress, report
        report(progress)

    def finish(self, pair: Pair, row: Row, options: str) -> None:
        """Keep one row."""
        self._store.finish(pair, row, options)
        before = self._progress
        failed = before.failed + (not row.table["success"])
        self._progress = before._replace(done=before.done + 1, failed=failed)
        self._report(self._progress)

    def fail(self, pair: Pair, outcome: Outcome) -> None:
        """Keep the row of a pair that was not registered, and why."""
        self.finish(pair, Row.failed(pair, outcome.reason, expected=outcome.expected), "")


def _register(items: Sequence[PairItem], engine: Engine, share: int, tally: _Tally) -> None:
    """Register slices; the pairs of one that fails are tried once more, each alone, so that none fails the others."""
    failed = _register_slices(plan.slices_of(items, engine.workers, share), engine, tally)
    alone = [(item,) for part, _ in failed for item in part if len(part) > 1]
    for part, outcome in [*failed, *_register_slices(alone, engine, tally)]:
        if len(part) == 1:
            tally.fail(part[0].pair, outcome)


def _register_slices(slices: Sequence[Slice], engine: Engine, tally: _Tally) -> list[tuple[Slice, Outcome]]:
    """Keep the rows of slices as they come; returns those that failed."""
    failed = []
    for place, outcome in engine.run(REGISTER, slices):
        stop_without_room(outcome)
        if outcome.reason:
            failed.append((slices[place], outcome))
            continue
        for item, row in zip(slices[place], outcome.value, strict=True):
            tally.finish(item.pair, row, _options_text(item.options))
    return failed


def _describe(
    missing: Sequence[DescribeItem], total: int, store: Store, engine: Engine, report: Report
) -> dict[str, Outcome]:
    """Describe clouds; returns the outcomes of those that could not be described, by their files."""
    lost: dict[str, Outcome] = {}
    report(BatchProgress("describe", total - len(missing), total))
    for count, (place, outcome) in enumerate(engine.run(DESCRIBE, missing), start=1):
        stop_without_room(outcome)
        store.add_work("describing clouds", outcome.seconds)
        if outcome.reason:
            lost[missing[place].file] = outcome
        report(BatchProgress("describe", total - len(missing) + count, total))
    return lost
