"""Small folders of pairs with a ``pairs.json``, as real scans come."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from problems import room_pair

import torchreg as tr


def project(folder: Path, scenes: Sequence[str] = ("hall", "hall", "yard")) -> Path:
    """Rooms with a ``pairs.json``; the pairs of a scene overlap less and less."""
    listed = []
    for seed, scene in enumerate(scenes):
        pair = room_pair(900, seed=seed)
        for side in ("source", "target"):
            tr.write_cloud(folder / f"{seed}_{side}.ply", getattr(pair, side))
        listed.append(
            {
                "name": f"pair_{seed}",
                "scene": scene,
                "source": f"{seed}_source.ply",
                "target": f"{seed}_target.ply",
                "T": pair.T_target_source[0].tolist(),
                "voxel_m": 0.2,
                "overlap": 0.8 - 0.3 * seed,
            }
        )
    (folder / "pairs.json").write_text(json.dumps({"pairs": listed}))
    return folder
