"""A whole batch: look at every cloud, describe each once, register the pairs, and keep what is done as it is done."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import torch

from torchreg.batch import plan
from torchreg.batch.clouds import Look
from torchreg.batch.engines import Engine
from torchreg.batch.jobs import DESCRIBE, LOOK, REGISTER, DescribeItem, LookItem, PairItem, said_of
from torchreg.batch.outcome import Outcome
from torchreg.batch.pairs import Pair
from torchreg.batch.plan import Bounds, CloudKey
from torchreg.batch.rows import RETRIED, Row
from torchreg.batch.scales import Scale, shared_scales
from torchreg.batch.store import Finished, Store, differences
from torchreg.batch.store import said_of as pair_said
from torchreg.registration.slices import budget


class Progress(NamedTuple):
    """How far a stage is.

    Attributes:
        stage: ``"look"``, ``"describe"`` or ``"register"``.
        done: of its items, those done before this run included.
        total: items of the stage.
        failed: of those done, how many pairs are no success (of the last stage).
    """

    stage: str
    done: int
    total: int
    failed: int = 0


Report = Callable[[Progress], None]


class Done(NamedTuple):
    """What a run came to.

    Attributes:
        before: pairs that were finished before and stand.
        now: pairs that were registered, or failed, in this run.
        described: clouds that were described in this run.
        reused: descriptions that were there already.
        changed: pairs of this run that had been finished with other clouds or lengths.
    """

    before: int
    now: int
    described: int
    reused: int
    changed: int


def run(
    pairs: Sequence[Pair],
    store: Store,
    engine: Engine,
    *,
    described: Path,
    bounds: Bounds,
    max_bytes: int | None = None,
    report: Report = lambda _: None,
) -> Done:
    """Register all pairs that are not finished yet; each is kept as soon as it is done.

    Args:
        pairs: of different names.
        store: where results go.
        engine: that does the work.
        described: the folder of descriptions, which exists; several batches may share it.
        bounds: when a pair with a truth counts as found.
        max_bytes: to work with, over all workers of this machine; ``None`` takes a quarter of the free memory.
        report: told of every step.

    Returns:
        Done. The rows are in the store.

    Raises:
        ValueError: a pair that is finished was told something else then.
        OSError: nothing can be written any more; what was finished stands.
    """
    finished = store.finished()
    _same_pairs(pairs, finished)
    share = max(1, budget(max_bytes, torch.device("cpu")) // engine.workers)
    looks, unreadable = _look(pairs, store, engine, report)
    scales = _scales(pairs, looks, store)
    todo = _todo(pairs, finished, looks, unreadable, scales, described, bounds, share)

    wanted = {side.file for item in todo.items for side in (item.source, item.target)}
    missing = plan.missing_descriptions(todo.items)
    lost = _describe(missing, len(wanted), store, engine, report)

    again = {pair.name for pair, _ in todo.failed} | {item.pair.name for item in todo.items}
    stand = [pair.name for pair in pairs if pair.name not in again]
    failures = sum(not finished[name].line["success"] for name in stand)
    tally = _Tally(store, Progress("register", len(stand), len(pairs), failures), report)
    for pair, reason in todo.failed:
        tally.finish(pair, Row.failed(pair, reason, expected=True), "")
    left: list[PairItem] = []
    for item in todo.items:
        missed = lost.get(item.source.file) or lost.get(item.target.file)
        if missed is None:
            left.append(item)
        else:
            failed = Row.failed(item.pair, missed.reason, expected=missed.expected)
            tally.finish(item.pair, failed, said_of(item.options))
    _register(left, looks, engine, share, tally)
    return Done(len(stand), len(again), len(missing) - len(lost), len(wanted) - len(missing), todo.changed)


class _Todo(NamedTuple):
    """Pairs to be registered, pairs that cannot be with the reason, and how many of the former were finished before
    with other clouds or lengths."""

    items: list[PairItem]
    failed: list[tuple[Pair, str]]
    changed: int


def _todo(
    pairs: Sequence[Pair],
    finished: Mapping[str, Finished],
    looks: Mapping[CloudKey, Look],
    unreadable: Mapping[CloudKey, str],
    scales: Mapping[CloudKey, Scale],
    described: Path,
    bounds: Bounds,
    share: int,
) -> _Todo:
    items, failed, stale = [], [], 0
    for pair in pairs:
        row, clouds = finished.get(pair.name), plan.clouds_of(pair)
        open_ = row is None or row.state in RETRIED
        broken = [unreadable[cloud] for cloud in clouds if cloud in unreadable]
        if broken:
            failed += [(pair, broken[0])] if open_ else []
            continue
        options = plan.options_for(pair, [looks[cloud] for cloud in clouds], [scales[cloud] for cloud in clouds])
        item = plan.pair_item(pair, options, looks, described, bounds, share)
        changed = row is not None and (row.digests != item.told.digests or row.options != said_of(options))
        if open_ or changed:
            items.append(item)
            stale += not open_
    return _Todo(items, failed, stale)


class _Tally:
    """Rows as they come: kept, counted, reported."""

    def __init__(self, store: Store, progress: Progress, report: Report) -> None:
        self._store, self._progress, self._report = store, progress, report
        report(progress)

    def finish(self, pair: Pair, row: Row, options: str) -> None:
        """Keep one row."""
        self._store.finish(pair, row, options)
        before = self._progress
        failed = before.failed + (not row.table["success"])
        self._progress = before._replace(done=before.done + 1, failed=failed)
        self._report(self._progress)


def _register(
    items: Sequence[PairItem], looks: Mapping[CloudKey, Look], engine: Engine, share: int, tally: _Tally
) -> None:
    slices = plan.slices_of(items, looks, engine.workers, share)
    for place, outcome in engine.run(REGISTER, slices):
        _stop_without_room(outcome)
        rows: Sequence[Row] = outcome.value or [
            Row.failed(item.pair, outcome.reason, expected=outcome.expected) for item in slices[place]
        ]
        for item, row in zip(slices[place], rows, strict=True):
            tally.finish(item.pair, row, said_of(item.options))


def _look(
    pairs: Sequence[Pair], store: Store, engine: Engine, report: Report
) -> tuple[dict[CloudKey, Look], dict[CloudKey, str]]:
    """What is known of every cloud, and why others cannot be read; files that did not change are not read again."""
    scaled: dict[CloudKey, bool] = {}
    for pair in pairs:
        for cloud in plan.clouds_of(pair):
            scaled[cloud] = scaled.get(cloud, False) or plan.needs_scale(pair)
    known = store.looks()
    looks: dict[CloudKey, Look] = {}
    unreadable: dict[CloudKey, str] = {}
    new: list[tuple[CloudKey, str]] = []
    for cloud, wanted in scaled.items():
        stamp = f"{_stamp(cloud[0].path)} {wanted}"
        if cloud in known and known[cloud][0] == stamp:
            looks[cloud] = known[cloud][1]
        else:
            new.append((cloud, stamp))
    items = [LookItem(source, asked, scaled[source, asked]) for (source, asked), _ in new]
    report(Progress("look", len(looks), len(scaled)))
    for count, (place, outcome) in enumerate(engine.run(LOOK, items), start=1):
        _stop_without_room(outcome)
        cloud, stamp = new[place]
        store.add_work("looking at clouds", outcome.seconds)
        if outcome.reason:
            unreadable[cloud] = outcome.reason
        else:
            looks[cloud] = outcome.value
            store.keep_look(*cloud, stamp, outcome.value)
        report(Progress("look", len(scaled) - len(items) + count, len(scaled)))
    return looks, unreadable


def _scales(pairs: Sequence[Pair], looks: Mapping[CloudKey, Look], store: Store) -> dict[CloudKey, Scale]:
    """The shared scale of every cloud; what was decided once stays."""
    own = {cloud: Scale(look.voxel, look.spacing) for cloud, look in looks.items()}
    kept = {cloud: scale for cloud, (_, _, scale) in store.looks().items() if scale is not None and cloud in own}
    links = [plan.clouds_of(pair) for pair in pairs]
    shared = shared_scales(own, [link for link in links if all(cloud in own for cloud in link)], kept)
    store.keep_scales({cloud: scale for cloud, scale in shared.items() if cloud not in kept})
    return shared


def _describe(
    missing: Sequence[DescribeItem], total: int, store: Store, engine: Engine, report: Report
) -> dict[str, Outcome]:
    """Describe clouds; returns what came of those that could not be, by their files."""
    lost: dict[str, Outcome] = {}
    report(Progress("describe", total - len(missing), total))
    for count, (place, outcome) in enumerate(engine.run(DESCRIBE, missing), start=1):
        _stop_without_room(outcome)
        store.add_work("describing clouds", outcome.seconds)
        if outcome.reason:
            lost[missing[place].file] = outcome
        report(Progress("describe", total - len(missing) + count, total))
    return lost


def _same_pairs(pairs: Sequence[Pair], finished: Mapping[str, Finished]) -> None:
    """Refuse pairs whose finished row was told something else."""
    for pair in pairs:
        if pair.name in finished:
            then, now = json.loads(finished[pair.name].said), json.loads(pair_said(pair))
            different = differences(then, now)
            if different:
                expected = "what it was when it was finished, or a new folder"
                raise ValueError(f"pair {pair.name}: expected {expected}, got {different}")


def _stop_without_room(outcome: Outcome) -> None:
    if outcome.no_room:
        raise OSError(f"{outcome.reason} (what is finished stands; the same command goes on from there)")


def _stamp(path: str) -> str:
    """What tells that a file was changed."""
    try:
        found = os.stat(path)
    except OSError:
        return "missing"
    return f"{found.st_size} {found.st_mtime_ns}"
