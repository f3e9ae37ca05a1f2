"""Refine transforms that are about right: iterative closest point, batched over pairs.

Besl and McKay (PAMI 14(2), 1992, doi:10.1109/34.121791); the update and the rule to stop are those of Open3D's
``registration_icp`` (Zhou, Park and Koltun, arXiv:1801.09847), whose results it gives.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torchreg.errors import expect, expect_device, expect_floating
from torchreg.refinement.checks import per_pair
from torchreg.refinement.options import IcpOptions
from torchreg.refinement.pairing import one_to_one
from torchreg.refinement.pairs import refine_pairs
from torchreg.refinement.result import IcpResult
from torchreg.types import Clouds


def icp(
    source: Clouds,
    target: Clouds,
    T_target_source: Tensor,
    options: IcpOptions | Sequence[IcpOptions] | None = None,
) -> IcpResult:
    """Refine the transforms of B pairs.

    All computing is in float64, on points relative to the origins and about the clouds' centers. A pair's result
    has the same bits alone, in any batch and with any number of threads.

    Args:
        source: B clouds; colors for ``kind="colored"``.
        target: B clouds; normals for ``kind="point_to_plane"`` and ``"colored"``, colors for the latter.
        T_target_source: (B, 4, 4), or (4, 4) for all pairs: where to start, rigid, meters, origins included.
        options: for all pairs, or one per pair; ``None`` is ``IcpOptions()``.

    Returns:
        IcpResult. A pair fails as data, with a reason: points, normals, colors or a transform that are not finite,
        an empty cloud, no correspondences, correspondences that leave the motion open. No gradients flow: inputs
        are detached.

    Raises:
        ValueError: sizes, dtypes or devices do not fit; normals or colors are missing.

    Example:
        >>> import torch
        >>> grid = torch.cartesian_prod(*[torch.arange(5.0)] * 3)
        >>> moved = Clouds(points=grid + 0.1)
        >>> result = icp(Clouds(points=grid), moved, torch.eye(4), IcpOptions(max_distance=0.5))
        >>> [round(x, 6) for x in result.T_target_source[0, :3, 3].tolist()]
        [0.1, 0.1, 0.1]
    """
    pairs = len(source)
    expect(len(target) == pairs, "target", f"{pairs} clouds, as the source has", len(target))
    expect_device(target.points, "target", source.device)
    expect(isinstance(T_target_source, Tensor), "T_target_source", "a tensor", T_target_source)
    expect(
        T_target_source.shape in ((4, 4), (pairs, 4, 4)),
        "T_target_source",
        f"(4, 4) or ({pairs}, 4, 4)",
        T_target_source,
    )
    expect_floating(T_target_source, "T_target_source")
    chosen = per_pair(options, pairs)
    T = T_target_source.to(source.device, torch.float64).expand(pairs, 4, 4)
    return refine_pairs(source, target, one_to_one(pairs), T, chosen)
