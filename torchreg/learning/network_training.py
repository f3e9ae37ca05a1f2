"""Training of a network by contrast over true correspondences, a step at a time, resumable to the bit.

Every step draws a group of scenes, a pair of it and a view of that (``posed_pairs``), and takes InfoNCE both ways: of
all points of the other scan, the true partner should be the most similar, as mutual matching will ask. What a step
draws follows from the seed and its number alone, and its rate from its number, so the state of a run is its weights,
the optimizer's moments, and the number.
"""

from __future__ import annotations

import math
import os
import pickle
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor, nn

from torchreg.augment.streams import derived_seed, generator_of
from torchreg.entry import entry
from torchreg.errors import at_least, expect, expect_in_words, positive
from torchreg.learning.correspondence_losses import info_nce
from torchreg.learning.posed_pairs import DescribedSide, PairView, PosedPair, random_view
from torchreg.nn.point_network import PointNetwork
from torchreg.seeds import any_seed, torch_seed
from torchreg.types import Neighborhoods

_IGNORED = 2.0  # partner radii; nearer points are no partners, but too near the true place to count as wrong
_LARGEST_GRADIENT = 1.0
_WARM_UP = 0.05  # share of the steps
_VIEWS = 8  # of which one may overlap


@dataclass(frozen=True, kw_only=True)
class NetworkTrainingOptions:
    """Options of training.

    Attributes:
        steps: of the optimizer, one view of one pair each.
        points: of a view, about, of either side.
        anchors: points a step and side whose partner is asked for, at most.
        rate: the largest step size of AdamW; it rises over the first twentieth and falls to zero as a cosine.
        decay: of weights.
        temperature: of InfoNCE.
        partner_voxels: points nearer than so many voxels under the true motion are the same place; those within twice
            as far do not count as wrong.
        seed: of all draws.

    Example:
        >>> import torchreg as tr
        >>> tr.learning.NetworkTrainingOptions(steps=300).anchors
        1024
    """

    steps: int = 3000
    points: int = 1200
    anchors: int = 1024
    rate: float = 1.5e-3
    decay: float = 1e-2
    temperature: float = 0.05
    partner_voxels: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        at_least(self.steps, "steps", 1)
        at_least(self.points, "points", 20)
        at_least(self.anchors, "anchors", 2)
        any_seed(self.seed)
        for name in ("rate", "temperature", "partner_voxels"):
            positive(getattr(self, name), name)
        expect(0 <= self.decay < 1, "decay", "a number in [0, 1)", self.decay)


class NetworkTraining:
    """A network in training.

    Args:
        pairs: to train on, at least one; every group is drawn as often.
        options: ``None``: the defaults.
        network: to train; ``None``: one drawn by the seed. It is trained in place.
        device: where the network is trained. Views are made on the CPU.

    Attributes:
        network: in training.
        options: of training.
        done: how many steps are done.

    Raises:
        ValueError: no pairs.

    Example:
        >>> import torchreg as tr
        >>> hall = tr.datasets.mall(seed=1, angular_step=3.0)
        >>> posed = tr.learning.PosedPair(hall, "malls", voxel=0.5)
        >>> options = tr.learning.NetworkTrainingOptions(steps=2, points=200)
        >>> training = NetworkTraining([posed], options)
        >>> losses = [training.step() for _ in range(options.steps)]
        >>> resumed = NetworkTraining([posed], options)
        >>> resumed.load_state_dict(training.state_dict())
        >>> resumed.done
        2
    """

    def __init__(
        self,
        pairs: Sequence[PosedPair],
        options: NetworkTrainingOptions | None = None,
        *,
        network: PointNetwork | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        expect(len(pairs) > 0, "pairs", "at least one", pairs)
        self.options = options or NetworkTrainingOptions()
        self.network = (drawn_network(self.options.seed) if network is None else network).to(device).train()
        self.done = 0
        groups: dict[str, list[PosedPair]] = {}
        for posed in pairs:
            groups.setdefault(posed.group, []).append(posed.thinned())
        self._groups = list(groups.values())
        self._optimizer = torch.optim.AdamW(
            self.network.parameters(), lr=self.options.rate, weight_decay=self.options.decay
        )

    def step(self) -> float:
        """Do one step and return its loss.

        Raises:
            ValueError: eight views in a row whose scans share nothing.
        """
        draw = generator_of(derived_seed(self.options.seed, "step", self.done))
        loss = contrast_loss(self.network, self._view(draw), self.options, draw)
        self._optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), _LARGEST_GRADIENT)
        for group in self._optimizer.param_groups:
            group["lr"] = self.rate
        self._optimizer.step()
        self.done += 1
        return float(loss.detach())

    @property
    def rate(self) -> float:
        """The step size of the next step."""
        share = self.done / self.options.steps
        rising = min(1.0, (self.done + 1) / max(1.0, _WARM_UP * self.options.steps))
        return self.options.rate * rising * 0.5 * (1 + math.cos(math.pi * min(1.0, share)))

    def state_dict(self) -> dict[str, Any]:
        """All that the next steps depend on beside the pairs; loads under ``torch.load(weights_only=True)``."""
        return {
            "done": self.done,
            "options": asdict(self.options),
            "sizes": self.network.sizes(),
            "network": self.network.state_dict(),
            "optimizer": self._optimizer.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from a state: with the same pairs, the next steps give the bits of a run that never stopped.

        Raises:
            ValueError: a state of other options or of a network of other sizes.
        """
        for name, mine in (("options", asdict(self.options)), ("sizes", self.network.sizes())):
            theirs = state[name]
            unlike = {key for key in mine.keys() | theirs.keys() if mine.get(key) != theirs.get(key)}
            expected = ", ".join(f"{key} {mine.get(key)}" for key in sorted(unlike))
            received = ", ".join(f"{key} {theirs.get(key)}" for key in sorted(unlike))
            expect_in_words(not unlike, "state", f"that of a run with {expected}", received)
        self.network.load_state_dict(state["network"])
        self._optimizer.load_state_dict(state["optimizer"])
        self.done = int(state["done"])

    def _view(self, draw: torch.Generator) -> PairView:
        """A view whose scans share at least two places."""
        for _ in range(_VIEWS):
            group = self._groups[int(torch.randint(len(self._groups), (1,), generator=draw))]
            posed = group[int(torch.randint(len(group), (1,), generator=draw))]
            seed = int(torch.randint(2**62, (1,), generator=draw))
            view = random_view(posed, seed, points=self.options.points, partner_voxels=self.options.partner_voxels)
            if int(view.is_partner.sum()) >= 2:
                return view
        raise ValueError(f"pairs: expected scans that overlap, got {_VIEWS} views in a row that share nothing")


def saved_network(training: NetworkTraining) -> dict[str, Any]:
    """A network for ``torch.save``, as ``load_network`` reads it: its sizes and weights, on the CPU."""
    weights = {name: value.detach().cpu().clone() for name, value in training.network.state_dict().items()}
    return {"sizes": training.network.sizes(), "network": weights}


@entry
def load_network(path: str | os.PathLike[str]) -> PointNetwork:
    """Read the network of a file of weights or of a checkpoint of ``torchreg train``, ready to describe clouds.

    Only tensors and numbers are read, no code. The weights take no gradients; ``requires_grad_()`` gives them back.

    Raises:
        FileNotFoundError: no such file.
        ValueError: a file of another kind.

    Example:
        >>> network = load_network("training/weights.pt")  # doctest: +SKIP
    """
    expected = f"{os.fspath(path)}: expected weights written by torchreg train"
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        state = state.get("training", state)
        network = drawn_network(0, **state["sizes"])
        network.load_state_dict(state["network"])
    except (pickle.UnpicklingError, RuntimeError, EOFError, AttributeError, KeyError, TypeError) as error:
        raise ValueError(f"{expected}, got another file ({type(error).__name__})") from None
    return network.eval().requires_grad_(False)


def drawn_network(seed: int, **sizes: int) -> PointNetwork:
    """An untrained network, of the usual sizes where none are given, its weights drawn by the seed.

    The global generator is left alone.
    """
    with torch.random.fork_rng(devices=[]), torch.device("cpu"):
        torch.manual_seed(torch_seed(seed))
        return PointNetwork(**sizes)


def contrast_loss(network: nn.Module, view: PairView, options: NetworkTrainingOptions, draw: torch.Generator) -> Tensor:
    """InfoNCE of points with a partner against all points of the other side, the mean of both ways. Gradients flow."""
    rows = view.is_partner.nonzero()[:, 0]
    rows = rows[torch.randperm(len(rows), generator=draw)[: options.anchors]]
    partners = view.partner[rows]
    source, target = (_features(network, side) for side in (view.source, view.target))
    reach = _IGNORED * options.partner_voxels * view.voxel

    def one_way(anchors: Tensor, others: Tensor, partner: Tensor, points: Tensor) -> Tensor:
        too_near = torch.cdist(points[partner], points) < reach
        device = others.device
        return info_nce(
            anchors, others, partner.to(device), ignored=too_near.to(device), temperature=options.temperature
        )

    forth = one_way(source[rows.to(source.device)], target, partners, view.target.cloud.points)
    back = one_way(target[partners.to(target.device)], source, rows, view.source.cloud.points)
    return (forth + back) / 2


def _features(network: nn.Module, side: DescribedSide) -> Tensor:
    device = next(network.parameters()).device
    near = side.near
    there = Neighborhoods(near.index.to(device), near.valid.to(device), near.sq_distance.to(device), near.radius)
    values: Tensor = network(side.cloud.to(device), there).values
    return values
