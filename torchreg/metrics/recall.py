"""Registration recall: the share of pairs that were found, under the two definitions in use."""

from __future__ import annotations

from torch import Tensor

from torchreg.errors import expect, positive
from torchreg.metrics.pose import rre, rte


def recalled_by_error(
    T_true: Tensor, T_estimated: Tensor, *, rotation: float = 15.0, translation: float = 0.3
) -> Tensor:
    """(B,) bool: rotation error (degrees) and translation error (meters) both below their bounds.

    The bounds are those of Choy, Dong and Koltun, Deep Global Registration, CVPR 2020,
    doi:10.1109/CVPR42600.2020.00259, for 3DMatch: 15 degrees and 0.3 m.
    """
    positive(rotation, "rotation")
    positive(translation, "translation")
    return (rre(T_true, T_estimated) < rotation) & (rte(T_true, T_estimated) < translation)


def recalled_by_rmse(errors: Tensor, *, bound: float = 0.2) -> Tensor:
    """(B,) bool: the root mean square error (B,) of true correspondences is below the bound.

    Choi, Zhou and Koltun, Robust Reconstruction of Indoor Scenes, CVPR 2015, doi:10.1109/CVPR.2015.7299195:
    0.2 m; the errors are ``rmse`` over the points that overlap under the truth.
    """
    positive(bound, "bound")
    return errors < bound


def registration_recall(recalled: Tensor) -> Tensor:
    """Share of pairs (B,) bool that were found, a scalar; at least one pair is needed."""
    expect(recalled.numel() > 0, "recalled", "at least one pair", recalled)
    return recalled.double().mean()
