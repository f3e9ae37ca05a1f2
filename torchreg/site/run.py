"""The scans of a site in files, registered on disk: resumable, by any number of processes or machines."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import torch

from torchreg.batch.engine import Engine
from torchreg.errors import CloudFileError, expect
from torchreg.io import Reading
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.plan import budget
from torchreg.site.frame import SiteFrame
from torchreg.site.pairs import PairPlan, Report
from torchreg.site.register_site import effort_of
from torchreg.site.result import SiteResult
from torchreg.site.solve import registered_share, solved
from torchreg.site.store import SiteStore, shard_folders
from torchreg.site.stored import FoundScans, StoredWork, scans_in_files


class Shard(NamedTuple):
    """One of several runs that share the pairs of a site.

    Attributes:
        number: of this run, from 1.
        shards: how many there are.
    """

    number: int
    shards: int

    @staticmethod
    def of_text(text: str, name: str) -> Shard:
        """The shard of a text such as "2/8".

        Raises:
            ValueError: another text; the message has ``name``.
        """
        number, _, shards = text.partition("/")
        legal = number.isdecimal() and shards.isdecimal() and 1 <= int(number) <= int(shards)
        expect(legal, name, "K/N, the Kth of N runs, such as 2/8", text)
        return Shard(int(number), int(shards))

    def folder(self, out: Path) -> Path:
        """Where it keeps what it found."""
        return out / "shards" / f"{self.number}-of-{self.shards}"


class SiteSettings(NamedTuple):
    """How the scans of files are read and registered.

    Attributes:
        reading: how the files are read.
        options: as for ``register_site``, and so are the next.
        effort: likewise.
        seed: likewise.
    """

    reading: Reading = Reading()
    options: RegistrationOptions | None = None
    effort: str | None = None
    seed: int = 0


class SiteRun(NamedTuple):
    """The scans of a run and where they are."""

    found: FoundScans
    result: SiteResult


_DEFAULT = SiteSettings()


def run_site(
    paths: Sequence[str | os.PathLike[str]],
    store: SiteStore,
    engine: Engine,
    *,
    described: Path,
    settings: SiteSettings = _DEFAULT,
    frame: Callable[[FoundScans], SiteFrame] = lambda _: SiteFrame(),
    max_bytes: int | None = None,
    report: Report = lambda _: None,
) -> SiteRun:
    """Put the scans of files into one frame, as ``register_site`` does; every pair is kept as soon as it is done.

    A run that was cut off goes on where it was, and its result has the bits of one that was not; so has that of any
    number of workers. What the shards in the store's folder found is taken over.

    Args:
        paths: of the files; a file with several scans gives all of them.
        store: the folder of the run.
        engine: that does the work.
        described: the folder of descriptions, which exists; several runs may share it.
        settings: of the run, those that the store was made with.
        frame: the frame that is wanted, of the scans that were found.
        max_bytes: about what pairs that are registered together may hold, over all workers.
        report: called at every step.

    Returns:
        SiteRun. A scan that cannot be read or used is named with its reason.

    Raises:
        CloudFileError: no file can be read.
        OSError: nothing can be written any more; what was kept before stays.
        ValueError: options that do not fit, or a shard with other settings.
    """
    for folder in shard_folders(store.folder):
        store.adopt(folder)
    plan, work, found = _begun(paths, store, engine, described, settings, max_bytes, report)
    return SiteRun(found, solved(found.scans, plan, work, frame=frame(found), seed=settings.seed, report=report))


def run_shard(
    paths: Sequence[str | os.PathLike[str]],
    store: SiteStore,
    engine: Engine,
    shard: Shard,
    *,
    described: Path,
    settings: SiteSettings = _DEFAULT,
    max_bytes: int | None = None,
    report: Report = lambda _: None,
) -> int:
    """Register a share of the pairs with which ``run_site`` would begin, and no more; returns how many.

    All shards together do the pairs of a small site, and those of the first round of a large one. Arguments and errors
    are those of ``run_site``.
    """
    plan, work, found = _begun(paths, store, engine, described, settings, max_bytes, report)
    share = slice(shard.number - 1, None, shard.shards)
    return registered_share(found.scans, plan, work, share, seed=settings.seed, report=report)


def _begun(
    paths: Sequence[str | os.PathLike[str]],
    store: SiteStore,
    engine: Engine,
    described: Path,
    settings: SiteSettings,
    max_bytes: int | None,
    report: Report,
) -> tuple[PairPlan, StoredWork, FoundScans]:
    expect(len(paths) > 0, "paths", "at least one file", paths)
    options = settings.options
    found = scans_in_files(paths, settings.reading, store, engine, scaled=options is None, report=report)
    if all(source is None for source in found.sources):
        reasons = "; ".join(dict.fromkeys(found.scans.trouble))
        raise CloudFileError(
            f"SCANS: expected files of scans, got none that can be read ({len(paths)} given): {reasons}"
        )
    plan = PairPlan(found.scans, options, effort_of(options, settings.effort))
    room = budget(max_bytes, torch.device("cpu"))
    return plan, StoredWork(found, store, engine, described=described, max_bytes=room, report=report), found
