"""Colored ICP (Park, Zhou and Koltun, ICCV 2017, doi:10.1109/ICCV.2017.25), in the form Open3D gives it.

Beside the distance to the plane, r_G = sqrt(1 - c) (p - q) . n, stands the difference of intensity, r_C = sqrt(c)
(I_p - I_q - d . (p' - q)), where p' is p on the plane of q, d the gradient of intensity on that plane and c the
color weight. Intensity is the mean of red, green and blue.
"""

from __future__ import annotations

from torch import Tensor

from torchreg.refinement.estimator import Estimator, Matched
from torchreg.refinement.gauss_newton import CHANNELS, products, solve
from torchreg.refinement.kernels import Kernel
from torchreg.refinement.point_to_plane import jacobian, plane_residual


def colored(kernel: Kernel) -> Estimator:
    """Gauss-Newton on both residuals; partners are (x, y, z, normal, gradient, intensity), ``extra`` is intensity.

    The kernel weighs each of the two by itself, with one scale, as Open3D does.
    """

    def terms(matched: Matched) -> Tensor:
        q, n, d, intensity = matched.partner.split([3, 3, 3, 1])
        distance, slope = plane_residual(matched), _dot(d, n)
        share, rest = matched.color_weight.sqrt(), (1 - matched.color_weight).sqrt()  # (k, 1)
        geometric = rest * distance
        weight = matched.inside * kernel(geometric, matched.kernel_scale)
        out = products(jacobian(matched.moved, rest * n, geometric), weight)
        on_plane = _dot(d, matched.moved - q) - distance * slope  # d . (p' - q)
        photometric = share * (matched.extra[0] - intensity[0] - on_plane)
        flat = (n * slope).sub_(d).mul_(share)  # -d on the plane
        weight = matched.inside * kernel(photometric, matched.kernel_scale)
        return products(jacobian(matched.moved, flat, photometric), weight, onto=out)

    return Estimator(CHANNELS, terms, solve)


def intensity_of(colors: Tensor) -> Tensor:
    """The mean of red, green and blue of colors (P, 3): (P,) float64."""
    red, green, blue = colors.double().unbind(1)
    return (red + green + blue) / 3


def _dot(left: Tensor, right: Tensor) -> Tensor:
    x, y, z = (left * right).unbind(0)
    return x + y + z
