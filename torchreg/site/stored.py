"""The scans of a site in files: described and registered by the processes of an engine, every pair kept at once."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from torchreg.batch.described_file import described_name
from torchreg.batch.engine import Engine, Outcome, stop_without_room
from torchreg.geometry.numerics.partition import partition
from torchreg.io import Reading
from torchreg.io.result_json import plain_data
from torchreg.registration.described import DescribedClouds
from torchreg.registration.options import RegistrationOptions
from torchreg.site import files
from torchreg.site.files import FileItem, ScanItem, ScanSource, SeenScan, SketchItem, SliceItem
from torchreg.site.pairs import DescriptionKey, Report, SitePair, SiteProgress, alike
from torchreg.site.panorama import Panorama
from torchreg.site.records import found_of_text, look_of_text
from torchreg.site.result import TriedPair
from torchreg.site.scans import SiteScans, site_scans
from torchreg.site.sketches import Sketch
from torchreg.site.store import SiteStore
from torchreg.site.work import SLICE_PAIRS, PairFound

_MEMORY_FACTOR = 6  # memory that a slice needs while it is worked on, as a multiple of its descriptions
_SLICE_BYTES = 12 << 20  # of the descriptions of a slice, some 40,000 points; larger ones save nothing
_ROUNDS = 4  # slices for every worker at least, so that all end at about the same time


class FoundScans(NamedTuple):
    """The scans of files, in the order of these, each file's in its own.

    Attributes:
        names: of every scan; the path of its file, with its name or number there where the file has several.
        files: of every scan, the path of its file and the place of that among those given: one may be given twice.
        sources: where each is read; ``None`` where the file cannot be read.
        posed: whether its file has a pose for each, which its points have applied.
        scans: what is known of each.
    """

    names: tuple[str, ...]
    files: tuple[tuple[str, int], ...]
    sources: tuple[ScanSource | None, ...]
    posed: tuple[bool, ...]
    scans: SiteScans

    def unreadable(self) -> list[tuple[str, str]]:
        """The names of files that cannot be read, and why."""
        rows = zip(self.names, self.sources, self.scans.trouble, strict=True)
        return [(name, trouble) for name, source, trouble in rows if source is None]


def scans_in_files(
    paths: Sequence[str | os.PathLike[str]],
    reading: Reading,
    store: SiteStore,
    engine: Engine,
    *,
    scaled: bool,
    report: Report,
) -> FoundScans:
    """Look at the scans of all files; a file that did not change since it was looked at is not read again.

    Args:
        paths: of the files.
        reading: how they are read.
        store: what is known already, and where it is kept.
        engine: that reads them.
        scaled: whether the scales of the scans are asked for.
        report: called at every step.
    """
    items = [FileItem(os.fspath(path), reading, scaled) for path in paths]
    seen: dict[int, list[SeenScan]] = {}
    for place, item in enumerate(items):
        known = store.seen(item)
        if known is not None:
            seen[place] = known
    missing = [place for place in range(len(items)) if place not in seen]
    report(SiteProgress("look", len(seen), len(items)))
    trouble: dict[int, str] = {}
    for number, outcome in engine.run(files.LOOK, [items[place] for place in missing]):
        stop_without_room(outcome)
        place = missing[number]
        if outcome.reason:
            trouble[place] = outcome.reason
        else:
            seen[place] = outcome.value
            store.keep_seen(items[place], outcome.value)
        report(SiteProgress("look", len(seen) + len(trouble), len(items)))
    names: list[str] = []
    given: list[tuple[str, int]] = []
    sources: list[ScanSource | None] = []
    looks, reasons, notes, posed = [], [], [], []
    for place, item in enumerate(items):
        if place in trouble:
            rows: list[SeenScan | None] = [None]
        else:
            rows = list(seen[place])
        for one in rows:
            several = len(rows) > 1 and one is not None
            names.append(f"{item.path} [{one.name or one.number}]" if several and one is not None else item.path)
            given.append((item.path, place))
            sources.append(None if one is None else ScanSource(item.path, one.number, reading))
            looks.append(None if one is None else look_of_text(one.look))
            posed.append(one is not None and one.posed)
            reasons.append(trouble.get(place, ""))
            notes.append(() if one is None else one.notes)
    scans = site_scans(looks, reasons)
    remarks = tuple((*first, *more) for first, more in zip(notes, scans.notes, strict=True))
    return FoundScans(
        tuple(names), tuple(given), tuple(sources), tuple(posed), SiteScans(scans.looks, scans.trouble, remarks)
    )


class StoredWork:
    """A ``SiteWork`` on files.

    Args:
        found: the scans.
        store: where pairs are kept as soon as they are registered.
        engine: that does the work.
        described: the folder of descriptions, which exists.
        max_bytes: about the memory for pairs that are registered together, over all workers.
        report: called at every step.
    """

    def __init__(
        self,
        found: FoundScans,
        store: SiteStore,
        engine: Engine,
        *,
        described: Path,
        max_bytes: int,
        report: Report,
    ) -> None:
        self._found, self._store, self._engine, self._folder = found, store, engine, described
        self._share = max(1, max_bytes // engine.workers)
        self._report = report
        self._items: dict[DescriptionKey, ScanItem] = {}
        self._there: set[DescriptionKey] = set()
        self._lost: dict[DescriptionKey, Outcome] = {}

    def sketches(self, wanted: Mapping[DescriptionKey, RegistrationOptions]) -> dict[DescriptionKey, Sketch]:
        """As ``SiteWork``'s.

        Raises:
            OSError: a scan can no longer be read or described.
        """
        self._describe(list(wanted))
        keys = list(wanted)
        items = [SketchItem(self._item(key), wanted[key]) for key in keys]
        result = {}
        for place, outcome in self._engine.run(files.SKETCH, items):
            stop_without_room(outcome)
            if outcome.reason:
                raise OSError(outcome.reason)
            result[keys[place]] = files.sketch_from(outcome.value)
        return {key: result[key] for key in keys}

    def registered(self, pairs: Sequence[SitePair], seed: int) -> Iterator[list[PairFound]]:
        """As ``SiteWork``'s: those that are kept first, then the others as they are done."""
        names = [self._name(pair, seed) for pair in pairs]
        kept = self._store.pairs(names)
        known = [place for place, name in enumerate(names) if name in kept]
        if known:
            yield [found_of_text(kept[names[place]], pairs[place].source, pairs[place].target) for place in known]
        left = [place for place in range(len(pairs)) if names[place] not in kept]
        self._describe([key for place in left for key in pairs[place].sides()])
        broken = [place for place in left if any(key in self._lost for key in pairs[place].sides())]
        if broken:
            yield [self._failed(pairs[place]) for place in broken]
        yield []
        left = [place for place in left if place not in set(broken)]
        failed: list[int] = []
        for places, outcome in self._run(self._slices(pairs, left), pairs, seed):
            if outcome.reason:
                failed += places
                continue
            yield self._keep(places, outcome, pairs, names)
        for places, outcome in self._run([[place] for place in failed], pairs, seed):
            if outcome.reason:
                yield [self._failed(pairs[places[0]], outcome)]
            else:
                yield self._keep(places, outcome, pairs, names)

    def described(self, key: DescriptionKey) -> DescribedClouds:
        """As ``SiteWork``'s."""
        return files.described_scan(self._item(key), "cpu")

    def panorama(self, key: DescriptionKey) -> Panorama | None:
        """As ``SiteWork``'s."""
        return files.panorama_of_scan(self._item(key))

    def _run(
        self, slices: Sequence[list[int]], pairs: Sequence[SitePair], seed: int
    ) -> Iterator[tuple[list[int], Outcome]]:
        items = []
        for places in slices:
            part = tuple(pairs[place] for place in places)
            keys = dict.fromkeys(key for pair in part for key in pair.sides())
            items.append(SliceItem(part, tuple(self._item(key) for key in keys), seed))
        for number, outcome in self._engine.run(files.REGISTER, items):
            stop_without_room(outcome)
            yield slices[number], outcome

    def _keep(
        self, places: Sequence[int], outcome: Outcome, pairs: Sequence[SitePair], names: Sequence[str]
    ) -> list[PairFound]:
        texts: list[str] = outcome.value
        self._store.keep_pairs({names[place]: text for place, text in zip(places, texts, strict=True)})
        return [
            found_of_text(text, pairs[place].source, pairs[place].target)
            for place, text in zip(places, texts, strict=True)
        ]

    def _failed(self, pair: SitePair, outcome: Outcome | None = None) -> PairFound:
        """A pair that could not be worked on; it is not kept, so that the next run tries it again."""
        lost = outcome or next(self._lost[key] for key in pair.sides() if key in self._lost)
        return PairFound(TriedPair(pair.source, pair.target, False, lost.reason, 0), ())

    def _describe(self, keys: Sequence[DescriptionKey]) -> None:
        missing = [key for key in dict.fromkeys(keys) if key not in self._there and key not in self._lost]
        total = len(self._there) + len(missing)
        there = [key for key in missing if os.path.exists(self._item(key).file)]
        self._there |= set(there)
        missing = [key for key in missing if key not in self._there]
        self._report(SiteProgress("describe", len(self._there), total))
        for place, outcome in self._engine.run(files.DESCRIBE, [self._item(key) for key in missing]):
            stop_without_room(outcome)
            if outcome.reason:
                self._lost[missing[place]] = outcome
            else:
                self._there.add(missing[place])
            done = len(self._there) + sum(key in self._lost for key in missing)
            self._report(SiteProgress("describe", done, total))

    def _item(self, key: DescriptionKey) -> ScanItem:
        if key not in self._items:
            source, digest = self._found.sources[key.scan], self._found.scans.look(key.scan).digest
            seen = digest if key.colored else f"{digest} without colors"
            file = self._folder / described_name(seen, key.description, self._engine.device)
            assert source is not None  # it could be looked at
            self._items[key] = ScanItem(source, digest, key, str(file))
        return self._items[key]

    def _name(self, pair: SitePair, seed: int) -> str:
        """What the result of a pair depends on, in short."""
        digests = [self._found.scans.look(scan).digest for scan in (pair.source, pair.target)]
        text = json.dumps([digests, plain_data(pair.options), pair.colored, seed], sort_keys=True)
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()

    def _slices(self, pairs: Sequence[SitePair], places: Sequence[int]) -> list[list[int]]:
        """Pairs that go together, as many as fit in the memory of one worker."""
        most = max(1, min(SLICE_PAIRS, -(-len(places) // (_ROUNDS * self._engine.workers))))
        slices: list[list[int]] = []
        for group in alike([pairs[place] for place in places]):
            own = [places[number] for number in group]
            sizes = [sum(os.stat(self._item(key).file).st_size for key in pairs[place].sides()) for place in own]
            for run in partition(sizes, min(_SLICE_BYTES, self._share // _MEMORY_FACTOR)):
                part = own[run]
                slices += [part[begin : begin + most] for begin in range(0, len(part), most)]
        return slices
