"""The pairs of the study: simulated malls, and real colored scans."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import torch

from torchreg.datasets import mall
from torchreg.io import read_cloud
from torchreg.learning.prepared import PreparedPair, prepare_pair

MALL_VOXEL = 0.2  # meters
MALL = "simulated malls"


def simulated_cases(seeds: Sequence[int]) -> list[PreparedPair]:
    """Two stations in a mall, one pair a seed."""
    pairs = []
    for seed in seeds:
        made = mall(seed=seed)
        pairs.append(
            prepare_pair(made.source, made.target, made.T_target_source, MALL_VOXEL, name=f"mall_{seed}", scene=MALL)
        )
    return pairs


def real_cases(folder: Path, names: Sequence[str] | None = None) -> list[PreparedPair]:
    """The colored pairs of a folder's ``pairs.json`` (name, scene, source, target, T, voxel_m, colour).

    Args:
        folder: where ``pairs.json`` lies and what its paths start from.
        names: only these pairs.
    """
    listed = json.loads((folder / "pairs.json").read_text())["pairs"]
    return [
        prepare_pair(
            read_cloud(folder / pair["source"]),
            read_cloud(folder / pair["target"]),
            torch.tensor(pair["T"], dtype=torch.float64),
            pair["voxel_m"],
            name=pair["name"],
            scene=pair["scene"],
        )
        for pair in listed
        if pair["colour"] and (names is None or pair["name"] in names)
    ]
