"""The same pipeline run by Open3D, and how far the two agree.

Open3D is imported when one of these functions is called.
"""

from torchreg.reference import open3d
from torchreg.reference.comparison import Comparison, compare

__all__ = ["Comparison", "compare", "open3d"]
