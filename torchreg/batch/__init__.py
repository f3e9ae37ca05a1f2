"""Hundreds of pairs: read, describe and register them in parallel, and resume where a run was cut off."""

from torchreg.batch.engine import BatchProgress, Engine
from torchreg.batch.local_engine import LocalEngine
from torchreg.batch.pairs import Pair, pairs_of_file, pairs_of_glob
from torchreg.batch.ray_engine import RayEngine
from torchreg.batch.rows import Bounds
from torchreg.batch.runner import RunCounts, run
from torchreg.batch.store import Store
from torchreg.settings import PairSettings

__all__ = [
    "BatchProgress",
    "Bounds",
    "Engine",
    "LocalEngine",
    "Pair",
    "PairSettings",
    "RayEngine",
    "RunCounts",
    "Store",
    "pairs_of_file",
    "pairs_of_glob",
    "run",
]
