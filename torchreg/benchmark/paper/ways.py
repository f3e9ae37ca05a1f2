"""In what ways pairs are registered: what the paper leaves open about normals and RANSAC, decided either way.

Open3D leaves the sign of a normal as its eigen-solver returns it, unless it is asked to turn normals, and takes the
transform of RANSAC's best sample as it is. The paper names neither step, so it most likely did neither.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from torchreg.reference.legacy import hybrid, point_cloud, rows
from torchreg.registration.options import RegistrationOptions
from torchreg.types import Clouds


@dataclass(frozen=True, kw_only=True)
class Procedure:
    """How every method registers a pair."""

    name: str  # for a column of a table
    title: str  # the same in full
    turned: bool  # normals face the scanner; else their signs are those of Open3D's eigen-solver
    refit: bool  # RANSAC refits its best hypotheses to their inliers; else it takes the one with the most inliers


OURS = Procedure(
    name="turned, refit", title="normals turned to the scanner, RANSAC's best refitted", turned=True, refit=True
)
AS_PAPER = Procedure(
    name="unturned, no refit",
    title="signs of normals left as they come, RANSAC's best sample taken as it is",
    turned=False,
    refit=False,
)
WAYS = (
    OURS,
    Procedure(
        name="turned, no refit",
        title="normals turned to the scanner, RANSAC's best sample taken as it is",
        turned=True,
        refit=False,
    ),
    Procedure(
        name="unturned, refit",
        title="signs of normals left as they come, RANSAC's best refitted",
        turned=False,
        refit=True,
    ),
    AS_PAPER,
)
"""The library's own first; the last is the one which the paper most likely ran."""

MAIN_WAYS = (OURS, AS_PAPER)
"""Without those between, which tell what each of the two steps does."""


def unturned(cloud: Clouds, options: RegistrationOptions) -> Clouds:
    """One cloud whose normals keep their lines and have the signs that Open3D's ``estimate_normals`` leaves them."""
    if cloud.normals is None:
        raise ValueError("cloud: expected normals, got none")
    other = point_cloud(replace(cloud, normals=None))
    other.estimate_normals(hybrid(options.normal_radius, options.normal_max_neighbors))
    against = (rows(other.normals).to(cloud.normals) * cloud.normals).sum(dim=1, keepdim=True) < 0
    return replace(cloud, normals=torch.where(against, -cloud.normals, cloud.normals))
