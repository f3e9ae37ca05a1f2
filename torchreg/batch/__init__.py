"""Hundreds of pairs: read, describe and register them in parallel, and go on where a run was cut off."""

from torchreg.batch.engines import Engine
from torchreg.batch.local_engine import LocalEngine
from torchreg.batch.pairs import Pair, pairs_of_file, pairs_of_glob
from torchreg.batch.plan import Bounds
from torchreg.batch.progress import Progress
from torchreg.batch.ray_engine import RayEngine
from torchreg.batch.run import Done, run
from torchreg.batch.settings import PairSettings
from torchreg.batch.store import Store

__all__ = [
    "Bounds",
    "Done",
    "Engine",
    "LocalEngine",
    "Pair",
    "PairSettings",
    "Progress",
    "RayEngine",
    "Store",
    "pairs_of_file",
    "pairs_of_glob",
    "run",
]
