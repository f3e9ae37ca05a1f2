"""Hundreds of pairs: read, describe and register them in parallel, and go on where a run was cut off."""

from torchreg.batch.pairs import Pair, pairs_of_file, pairs_of_glob
from torchreg.batch.plan import Bounds
from torchreg.batch.run import Done, Progress, run
from torchreg.batch.settings import PairSettings
from torchreg.batch.store import Store

__all__ = ["Bounds", "Done", "Pair", "PairSettings", "Progress", "Store", "pairs_of_file", "pairs_of_glob", "run"]
