"""Global registration of colored point clouds in PyTorch.

    Clouds -> downsample -> neighbors -> normals -> descriptors -> fuse -> match_mutual -> ransac | compatibility

Each arrow is one public function, tensors in and a named type out. ``register`` runs them for batches of pairs. Unless
the effort is plain, it lets the poses of several sets of features compete on the clouds, refines them by ICP and gives
the probability that the winner is right.
"""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import TYPE_CHECKING

from torchreg import metrics
from torchreg.descriptors.color import soft_equalize
from torchreg.descriptors.contrast import Contrast, contrast
from torchreg.descriptors.descriptor import Descriptor
from torchreg.descriptors.fpfh import Fpfh, fpfh
from torchreg.descriptors.fuse import fuse
from torchreg.descriptors.learned import Learned
from torchreg.descriptors.local_frames import local_frames
from torchreg.descriptors.pcfh import Pcfh, pcfh
from torchreg.descriptors.pfh import Pfh, pfh
from torchreg.descriptors.pfhrgb import PfhRgb, pfhrgb
from torchreg.descriptors.shape_context import ShapeContext, shape_context
from torchreg.descriptors.shot import Cshot, Shot, cshot, shot
from torchreg.descriptors.spin_images import SpinImages, spin_images
from torchreg.geometry.kabsch import kabsch
from torchreg.geometry.numerics.compiled import compiled_kernels
from torchreg.geometry.se3 import transform
from torchreg.io import (
    from_numpy,
    from_open3d,
    from_pyg,
    from_pytorch3d,
    read_cloud,
    read_scans,
    to_numpy,
    to_open3d,
    to_pyg,
    to_pytorch3d,
    write_cloud,
)
from torchreg.matching import match_mutual, soft_match
from torchreg.native import native_kernels, native_library
from torchreg.neighborhoods import neighbors
from torchreg.preprocess import (
    estimate_normals,
    farthest_point_downsample,
    random_downsample,
    voxel_downsample,
)
from torchreg.refinement import IcpOptions, IcpResult
from torchreg.refinement.icp import icp
from torchreg.registration import LEARNED, PAPER, derive_options, options_for
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.outside import KeypointFeatures
from torchreg.registration.register import register
from torchreg.registration.register_features import register_features, register_matches
from torchreg.registration.spacing import spacing
from torchreg.registration.verify import verify
from torchreg.site import SiteResult
from torchreg.site.register_site import register_site
from torchreg.solvers import CompatibilityOptions, RansacOptions, Solver
from torchreg.solvers.compatibility import compatibility
from torchreg.solvers.ransac import ransac
from torchreg.types import (
    Clouds,
    Correspondences,
    Failure,
    Features,
    HypothesisCounts,
    Neighborhoods,
    RegistrationResult,
    SoftCorrespondences,
    Verification,
)
from torchreg.version import __version__

if TYPE_CHECKING:
    from torchreg import augment, batch, datasets, learning, nn, reference, synthetic

__all__ = [
    "LEARNED",
    "PAPER",
    "Clouds",
    "CompatibilityOptions",
    "Contrast",
    "Correspondences",
    "Cshot",
    "Descriptor",
    "Failure",
    "Features",
    "Fpfh",
    "HypothesisCounts",
    "IcpOptions",
    "IcpResult",
    "KeypointFeatures",
    "Learned",
    "Neighborhoods",
    "Pcfh",
    "Pfh",
    "PfhRgb",
    "RansacOptions",
    "RegistrationOptions",
    "RegistrationResult",
    "ShapeContext",
    "Shot",
    "SiteResult",
    "SoftCorrespondences",
    "Solver",
    "SpinImages",
    "Verification",
    "__version__",
    "augment",
    "batch",
    "compatibility",
    "compiled_kernels",
    "contrast",
    "cshot",
    "datasets",
    "derive_options",
    "estimate_normals",
    "farthest_point_downsample",
    "fpfh",
    "from_numpy",
    "from_open3d",
    "from_pyg",
    "from_pytorch3d",
    "fuse",
    "icp",
    "kabsch",
    "learning",
    "local_frames",
    "match_mutual",
    "metrics",
    "native_kernels",
    "native_library",
    "neighbors",
    "nn",
    "options_for",
    "pcfh",
    "pfh",
    "pfhrgb",
    "random_downsample",
    "ransac",
    "read_cloud",
    "read_scans",
    "reference",
    "register",
    "register_features",
    "register_matches",
    "register_site",
    "shape_context",
    "shot",
    "soft_equalize",
    "soft_match",
    "spacing",
    "spin_images",
    "synthetic",
    "to_numpy",
    "to_open3d",
    "to_pyg",
    "to_pytorch3d",
    "transform",
    "verify",
    "voxel_downsample",
    "write_cloud",
]

_ON_FIRST_USE = ("augment", "batch", "datasets", "learning", "nn", "reference", "synthetic")


def _explain(result: RegistrationResult, pair: int) -> str:
    """The text of ``RegistrationResult.explain``, from ``report``, which is imported at the first call."""
    from torchreg.report.explain.explanation import explanation

    return explanation(result, pair)


def _explain_verification(verification: Verification, pair: int) -> str:
    """The text of ``Verification.explain``, likewise."""
    from torchreg.report.explain.given import explanation_of_given

    return explanation_of_given(verification, pair)


def _summarize_site(site: SiteResult) -> str:
    """The text of ``SiteResult.summary``, likewise."""
    from torchreg.report.site_text import summary_of

    return summary_of(site)


RegistrationResult.explainer = _explain
Verification.explainer = _explain_verification
SiteResult.summarizer = _summarize_site


def __dir__() -> list[str]:
    return __all__


def __getattr__(name: str) -> ModuleType:
    if name in _ON_FIRST_USE:
        return importlib.import_module(f"torchreg.{name}")
    raise AttributeError(f"module 'torchreg' has no attribute {name!r}")
