"""A small network over neighborhoods that maps every point to a feature, to be trained by ``torchreg train``.

Every layer sends a message from each neighbor j to its point i and keeps the largest and the mean of them:

    m_ij = relu(A h_j + B h_i + C e_ij + b),   h_i <- norm(h_i + mlp(max_j m_ij, mean_j m_ij))

with e_ij the cues of the pair (``nn.cues``) and h_i at first a projection of the cues of the point. The feature is a
function of h_i before, between and after the layers: what one sees near and what one sees far. This is an edge
convolution (Wang et al., DGCNN, 2019, doi:10.1145/3326362) whose edges know shape and color by numbers that do not
turn with the cloud, as in PPFNet (Deng et al., CVPR 2018, doi:10.1109/CVPR.2018.00028). So the features are invariant
to rigid motion by construction, not by training on turned clouds. Local frames were left: on flat surfaces, of which
most scans consist, two of their axes are noise, and every cue in such a frame is then wrong at once.

Two layers over supports of 5 voxels see 10 voxels far.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn.functional import relu

from torchreg.errors import at_least, expect, expect_in_words
from torchreg.geometry.numerics.chunks import row_chunks
from torchreg.neighborhoods import neighbors
from torchreg.nn.cues import PAIR_CUES, POINT_CUES, pair_cues, point_cues
from torchreg.preprocess import estimate_normals
from torchreg.registration.spacing import spacing
from torchreg.types import Clouds, Features, Neighborhoods
from torchreg.types.precision import full_precision

BLOCK = "network"
SUPPORT, MAX_NEIGHBORS = 5.0, 100  # spacings and neighbors, as FPFH has them by default
NORMAL_SUPPORT, NORMAL_NEIGHBORS = 0.4, 30  # shares of the support
_CHUNK = 1 << 21  # elements of a (rows, K, width) temporary


class PointNetwork(nn.Module):
    """Features of points from the geometry and the color of their neighborhoods; 188,896 weights by default.

    Args:
        features: D, columns of the result.
        width: columns of messages and between layers.
        hidden: columns inside the layers' networks.
        layers: of messages, each of which sees one support farther.
        stride: of the neighbors in ascending distance every so many-th sends a message; FPFH, among the cues, reads
            all.

    The weights are drawn by PyTorch's generator. A module is called with clouds of any scale: all lengths are shares of
    the support's radius.

    Raises:
        ValueError: a number below 1.

    Example:
        >>> import torchreg as tr
        >>> cloud = tr.Clouds(torch.rand(200, 3), colors=torch.rand(200, 3))
        >>> PointNetwork()(cloud).values.shape
        torch.Size([200, 32])
    """

    def __init__(
        self, *, features: int = 32, width: int = 64, hidden: int = 256, layers: int = 2, stride: int = 3
    ) -> None:
        super().__init__()
        self.features = at_least(features, "features", 1)
        self.width = at_least(width, "width", 1)
        self.hidden = at_least(hidden, "hidden", 1)
        self.stride = at_least(stride, "stride", 1)
        self.enter = _mlp(POINT_CUES, 2 * width, width)
        self.layers = nn.ModuleList(_Messages(width, hidden) for _ in range(at_least(layers, "layers", 1)))
        self.leave = _mlp((layers + 1) * width, 4 * width, features)

    def sizes(self) -> dict[str, int]:
        """The arguments that make a network of these sizes: ``PointNetwork(**network.sizes())``."""
        return {
            "features": self.features,
            "width": self.width,
            "hidden": self.hidden,
            "layers": len(self.layers),
            "stride": self.stride,
        }

    @full_precision
    def forward(self, cloud: Clouds, near: Neighborhoods | None = None) -> Features:
        """Features of one block ("network", D), rows of unit length.

        Args:
            cloud: B clouds, thinned to even spacing; P points. With normals, or they are estimated here. Colors are
                used where there are any.
            near: the support of every point, its radius known; ``None`` takes 5 spacings of each cloud
                (``torchreg.spacing``) and 100 neighbors.

        Returns:
            Features. A point without a neighbor besides itself has a zero row and is not valid. A batch gives the rows
            that its clouds give one by one, up to rounding. Gradients flow to the weights, and through the pair cues to
            points, normals and colors; FPFH and contrast, which are cues too, pass none on.

        Raises:
            ValueError: neighborhoods of other points or without a radius, or numbers that are not finite.
        """
        near = _default_support(cloud) if near is None else near
        expect(len(near) == len(cloud.points), "near", f"neighborhoods of {len(cloud.points)} points", len(near))
        expect_in_words(near.radius is not None, "near", "neighborhoods whose radius is known", "radius None")
        assert near.radius is not None
        if cloud.normals is None:
            cloud = estimate_normals(cloud, near.restrict(near.radius * NORMAL_SUPPORT, NORMAL_NEIGHBORS))
        cues = point_cues(cloud, near)
        index, valid = near.index[:, :: self.stride], near.valid[:, :: self.stride]
        dtype = next(self.parameters()).dtype
        pairs = pair_cues(cloud, cues.color, index, near.radius).to(dtype)
        levels = [self.enter(cues.rows.to(dtype))]
        for layer in self.layers:
            levels.append(layer(levels[-1], pairs, index, valid))
        unit = torch.nn.functional.normalize(self.leave(torch.cat(levels, dim=1)), dim=1, eps=1e-6)
        values = torch.where(cues.described[:, None], unit, 0).to(cloud.points.dtype)
        return Features(values, cloud.offsets, ((BLOCK, self.features),), cues.described)

    def extra_repr(self) -> str:
        """What ``print`` shows."""
        return ", ".join(f"{name}={value}" for name, value in self.sizes().items())


class _Messages(nn.Module):
    """One layer: messages from neighbors, their largest and their mean, and a network over both."""

    def __init__(self, width: int, hidden: int) -> None:
        super().__init__()
        self.sender = nn.Linear(width, width, bias=False, dtype=torch.float32)
        self.receiver = nn.Linear(width, width, dtype=torch.float32)
        self.pair = nn.Linear(PAIR_CUES, width, bias=False, dtype=torch.float32)
        self.update = _mlp(2 * width, hidden, width)
        self.norm = nn.LayerNorm(width, dtype=torch.float32)

    def forward(self, rows: Tensor, pairs: Tensor, index: Tensor, valid: Tensor) -> Tensor:
        """Rows (P, width) from rows (P, width) and cues of pairs (P, K, 9), by neighbors of which some are valid."""
        sent, received = self.sender(rows), self.receiver(rows)
        width = rows.shape[1]
        pooled = [sent.new_zeros(0, 2 * width)]
        for part in row_chunks(len(rows), index.shape[1] * width, _CHUNK):
            near, counted = index[part], valid[part, :, None].to(rows.dtype)
            edges = self.pair(pairs[part])  # (R, K, width)
            other = sent.index_select(0, near.reshape(-1)).view_as(edges)
            message = relu(other + received[part, None] + edges) * counted
            mean = message.sum(dim=1) / counted.sum(dim=1).clamp(min=1)
            pooled.append(torch.cat([message.amax(dim=1), mean], dim=1))
        changed: Tensor = self.norm(rows + self.update(torch.cat(pooled)))
        return changed


def _mlp(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    first, last = nn.Linear(inputs, hidden, dtype=torch.float32), nn.Linear(hidden, outputs, dtype=torch.float32)
    return nn.Sequential(first, nn.ReLU(), last)


def _default_support(cloud: Clouds) -> Neighborhoods:
    radii = SUPPORT * spacing(cloud.detach())
    radii = torch.where(radii > 0, radii, 1.0)  # of clouds of fewer than five points
    one = len(radii) > 0 and bool((radii == radii[0]).all())
    return neighbors(cloud, float(radii[0]) if one else radii, MAX_NEIGHBORS)
