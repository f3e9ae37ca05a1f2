"""A trained network as one descriptor among others, so that ``register`` compares its features beside them."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

import torch
from torch import Tensor

from torchreg.descriptors.descriptor import Descriptor
from torchreg.descriptors.fpfh import Fpfh
from torchreg.nn.point_network import BLOCK, PointNetwork
from torchreg.types import Clouds, Features, Neighborhoods


@dataclass(frozen=True, kw_only=True)
class NetworkBlock(Descriptor):
    """The features of a ``PointNetwork``, such as ``torchreg train`` writes.

    Attributes:
        network: which; it lies on the device of the clouds. The record is another one for every network object, even
            of the same weights.
        radius: meters, as it was trained with: 5 spacings.

    Example:
        >>> import torchreg as tr
        >>> from dataclasses import replace
        >>> options = tr.options_for(0.05)
        >>> block = NetworkBlock(network=PointNetwork(), radius=0.25)
        >>> options = replace(
        ...     options, descriptors=(*options.descriptors, block), weights=(*options.weights, 1.0)
        ... )
        >>> [record.name for record in options.descriptors]
        ['fpfh', 'contrast', 'pcfh', 'network']
    """

    name: ClassVar[str] = BLOCK
    is_batched: ClassVar[bool] = True

    network: PointNetwork = field(kw_only=True)

    def __reduce__(self) -> tuple[Any, ...]:
        """Numbers alone, so that results that hold one may be loaded with ``weights_only=True``."""
        given = {each.name: getattr(self, each.name) for each in fields(self) if each.name != "network"}
        weights = {name: value.detach().cpu() for name, value in self.network.state_dict().items()}
        return _block_of, (given, self.network.sizes(), weights)

    @property
    def reach(self) -> float:
        """Meters: every layer sees one support farther than the cues, which are FPFH's."""
        return len(self.network.layers) * self.radius + Fpfh(radius=self.radius).reach

    def describe(self, cloud: Clouds, near: Neighborhoods) -> Features:
        """The network's features, without gradients."""
        with torch.no_grad():
            features: Features = self.network(cloud, near)
        return features


def _block_of(given: dict[str, Any], sizes: dict[str, int], weights: dict[str, Tensor]) -> NetworkBlock:
    network = PointNetwork(**sizes)
    network.load_state_dict(weights)
    return NetworkBlock(network=network.eval().requires_grad_(False), **given)


torch.serialization.add_safe_globals([_block_of])  # it makes numbers into a network, and runs no code of a file
