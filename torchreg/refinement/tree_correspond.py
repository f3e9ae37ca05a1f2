"""Nearest target points of moving source points, by a compiled kernel."""

from __future__ import annotations

import torch
from torch import Tensor

from torchreg.native import call, native
from torchreg.refinement.blocks import Blocks
from torchreg.refinement.correspond import Correspondence, Target
from torchreg.refinement.tree_search import addresses


def correspondences(blocks: Blocks, source: Tensor, target: Target, max_distance: Tensor) -> Correspondence:
    """Correspondences not yet moved, source (3, n, 256) about its centers, ``max_distance`` (B,) meters."""
    trees = addresses(target.search)
    kind = Correspondence if trees is None or not native(source, target.values) else TreeCorrespondence
    return kind(blocks, source, target, max_distance)


class TreeCorrespondence(Correspondence):
    """As ``Correspondence``, where every target has a ``TreeSearch``.

    Where a source point has no partner, ``partner`` keeps the last one, and ``square`` is zero.
    """

    _by_axis = ("source", "moved", "partner")
    _by_row = ("square", "inside", "_known", "_rows")

    def _begin(self) -> None:
        """Nothing has been searched."""
        self._known = self.source.new_empty(len(self.square), call("search_state_size"))
        self._rows = self.blocks.real.sum(dim=1)  # (n,)
        self._fresh = True

    def move(self, rotation: Tensor, translation: Tensor) -> None:
        """Update the correspondences to R (B, 3, 3) and t (B, 3) of the active pairs."""
        trees = addresses([self.target.search[b] for b in self.pairs])
        values = self.target.values
        call(
            "move_blocks",
            self.source,
            len(self.square),
            self.blocks.pair,
            self._rows,
            trees,
            values,
            *values.shape,
            torch.tensor([self.target.first[b] for b in self.pairs]),
            self.max_distance.contiguous(),
            rotation.contiguous(),
            translation.contiguous(),
            self._known,
            int(self._fresh),
            self.moved,
            self.partner,
            self.square,
            self.inside,
        )
        self._fresh = False
