"""How the work on many pairs is done: engine, processes, memory, device."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from torchreg.batch import Engine, LocalEngine, RayEngine
from torchreg.cli import options as opt
from torchreg.cli.guard import complain
from torchreg.errors import expect
from torchreg.io.atomic import remove_remains


@contextmanager
def resumable(folder: Path) -> Iterator[None]:
    """Say, where this block is interrupted, that what was done is kept in ``folder``."""
    try:
        yield
    except KeyboardInterrupt:
        complain(f"what was done is kept in {folder}; the same command resumes from there")
        raise


class EngineKind(str, Enum):
    """What runs the work."""

    local = "local"
    ray = "ray"


@dataclass(frozen=True, kw_only=True)
class Work:
    """How many pairs are computed; of this, the device alone may change the last bits of a result."""

    engine: Annotated[
        EngineKind,
        typer.Option(
            "--engine",
            help="What does the work: processes of this machine (local), or workers of Ray, here or on a cluster "
            "(ray). The results are the same.",
            rich_help_panel=opt.RUN,
        ),
    ] = EngineKind.local
    ray_address: Annotated[
        str | None,
        typer.Option(
            "--ray-address",
            metavar="ADDRESS",
            help="Ray cluster to join: HOST:PORT, ray://HOST:PORT, or auto; by default one is started here.",
            rich_help_panel=opt.RUN,
        ),
    ] = None
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers",
            metavar="COUNT",
            min=0,
            help="How many processes work at once; 0 starts none and works in this one; by default one per core.",
            rich_help_panel=opt.RUN,
        ),
    ] = None
    cache: Annotated[
        Path | None,
        typer.Option(
            "--cache",
            metavar="FOLDER",
            help="Folder for the descriptions of clouds, which several runs may share; by default the folder described "
            "in that of the results.",
            rich_help_panel=opt.RUN,
        ),
    ] = None
    max_bytes: Annotated[
        int | None,
        typer.Option(
            "--max-bytes",
            metavar="BYTES",
            min=1,
            help="Memory, in bytes, for the pairs that all workers register together; by default a quarter of what is "
            "free.",
            rich_help_panel=opt.RUN,
        ),
    ] = None
    device: opt.DeviceName = opt.Device.cpu

    def check(self) -> None:
        """Check before anything begins that the folder of descriptions can be one."""
        if self.cache is not None:
            fits = self.cache.absolute().parent.is_dir() and (not self.cache.exists() or self.cache.is_dir())
            expect(fits, "--cache", "a folder, or a name for one in a folder that exists", str(self.cache))

    def folder(self, out: Path) -> Path:
        """The folder of descriptions of a run with the folder ``out``, made if need be."""
        described = (out / "described" if self.cache is None else self.cache).absolute()
        described.mkdir(exist_ok=True)
        remove_remains(described, older_than=3600.0)
        return described

    def start(self) -> Engine:
        """The engine that does the work."""
        ray = self.engine is EngineKind.ray
        expect(self.ray_address is None or ray, "--ray-address", "--engine ray beside it", self.engine.value)
        if ray:
            return RayEngine(self.workers, self.ray_address, self.device.value)
        return LocalEngine(self.workers, self.device.value)
