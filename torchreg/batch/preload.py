"""All that a worker process needs, imported: what a server of processes loads once for all of them."""

from torchreg.batch import jobs
from torchreg.open3d_loader import load_open3d

__all__ = ["jobs"]

load_open3d()
