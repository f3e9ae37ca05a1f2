"""The result of a registration as JSON, with its options and the versions that computed it."""

from __future__ import annotations

import hashlib
import json
import math
import os
import platform
import sys
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from torchreg.entry import entry
from torchreg.errors import expect
from torchreg.geometry.se3 import quaternion_wxyz
from torchreg.io.atomic import write_text
from torchreg.types import RegistrationResult
from torchreg.verification.likeliest import likeliest_pose
from torchreg.version import __version__

_VERIFIED = ("probability", "overlap", "strength", "information", "runner_up", "margin")
_REFINED = ("residual_median", "residual_rms", "residual_95", "covariance", "center", "axis_strength")


@entry
def result_to_dict(
    result: RegistrationResult, pair: int = 0, *, seed: int, source: str, target: str
) -> dict[str, object]:
    """One pair of a result as plain numbers, texts and lists, ready for JSON.

    Numbers that are not finite become ``None`` (in JSON ``null``), as do those that a solver alone does not give.
    ``seconds`` are those of the whole batch.

    Args:
        result: of B pairs.
        pair: which one, from 0 to B - 1.
        seed: what the registration was run with.
        source: name of the source cloud for the file.
        target: name of the target cloud.

    Returns:
        A dictionary with the keys

        - ``source``, ``target``: the names given; ``success``, ``reason`` (empty beside success); ``failure``: kind and
          figures, as ``Failure`` has them, or ``None``; ``notes`` (list);
        - ``T_target_source``: 4 x 4, meters; ``quaternion``: w, x, y, z of its rotation, w >= 0; ``translation``; all
          three ``None`` where the pair was refused;
        - ``likeliest_T_target_source``: 4 x 4, the likeliest pose of a pair that was refused, ``None`` where the pair
          succeeded and where no pose was found;
        - ``fitness``, ``inlier_rmse`` (meters), ``probability``, ``overlap``, ``strength``: numbers;
        - ``information``: 6 x 6, rotations before translations, or ``None``;
        - ``runner_up``: 4 x 4, or ``None`` where there is none; ``margin``: log-odds, ``None`` where infinite;
        - ``residual_median``, ``residual_rms``, ``residual_95``: meters; ``covariance``: 6 x 6, rotations (radians)
          about ``center`` (x, y, z in the target's frame) before translations (meters); ``axis_strength``: 6 numbers,
          in the same order; ``None`` where the pose was not refined;
        - ``candidates``: a list, best first, of origin, T_target_source (4 x 4), support, matches, surprise, overlap,
          closeness, normals, colors, conflict, log_odds, probability, as ``Candidate`` describes them;
        - ``stages``: given, points and described (source and target each), and proposals, a list of origin, matches,
          drawn, kept, scored, poses, support, as ``StageCounts`` and ``Proposal`` describe them; or ``None``;
        - ``counts``: correspondences, inliers, hypotheses_drawn, hypotheses_kept, hypotheses_scored;
        - ``seed``; ``options``: all fields of ``RegistrationOptions``, or ``None``; ``seconds``: by stage;
        - ``versions``: of this library, what it computes with, and the platform.

    Raises:
        ValueError: ``pair`` is not one of the result's.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=4.0)
        >>> result = tr.register(pair.source, pair.target, effort="plain")
        >>> tr.io.result_to_dict(result, seed=0, source="a.ply", target="b.ply")["source"]
        'a.ply'
    """
    expect(0 <= pair < len(result), "pair", f"a number from 0 to {len(result) - 1}", pair)
    success, T = bool(result.success[pair]), likeliest_pose(result, pair)
    begin, end = result.correspondences.offsets[pair : pair + 2].tolist()
    counts = {f"hypotheses_{key}": int(value[pair]) for key, value in result.hypotheses._asdict().items()}
    failure, stages = result.failure[pair], None
    if result.stages:
        stages = plain_data(result.stages[pair])
        for name in ("given", "points", "described"):
            stages[name] = dict(zip(("source", "target"), stages[name], strict=True))
    content = {
        "source": source,
        "target": target,
        "success": success,
        "reason": result.reason[pair],
        "failure": None if failure is None else {"kind": failure.kind, "figures": failure.figures},
        "notes": result.notes[pair] if result.notes else (),
        **_pose(T if success else None),
        "likeliest_T_target_source": None if success else T,
        "fitness": float(result.fitness[pair]),
        "inlier_rmse": float(result.inlier_rmse[pair]),
        **{name: number_or_matrix(getattr(result, name), pair) for name in (*_VERIFIED, *_REFINED)},
        "candidates": result.candidates[pair] if result.candidates else (),
        "stages": stages,
        "counts": {"correspondences": end - begin, "inliers": int(result.inliers[begin:end].sum()), **counts},
        "seed": seed,
        "options": result.options[pair] if result.options else None,
        "seconds": dict(result.seconds),
        "versions": versions(),
    }
    return {key: plain_data(value) for key, value in content.items()}


@entry
def write_result_json(
    path: str | os.PathLike[str],
    result: RegistrationResult,
    pair: int = 0,
    *,
    seed: int,
    source: str,
    target: str,
) -> None:
    """Write ``result_to_dict`` of these arguments to a file, in full or not at all.

    Raises:
        ValueError: ``pair`` is not one of the result's, or the folder does not exist.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=4.0)
        >>> result = tr.register(pair.source, pair.target, effort="plain")
        >>> tr.io.write_result_json("ab.json", result, seed=0, source="a.ply", target="b.ply")
    """
    content = result_to_dict(result, pair, seed=seed, source=source, target=target)
    write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def plain_data(value: Any) -> Any:  # noqa: ANN401
    """Any value of this package as JSON has it, all the way down.

    Dataclasses and named tuples become dictionaries of their fields, headed by ``name`` where the class has one (such
    as the records of descriptors and solvers), modules their class and a digest of their weights; tensors and sequences
    become lists, numbers that are not finite become ``None``.
    """
    if isinstance(value, Tensor):
        return plain_data(value.detach().cpu().tolist())
    if isinstance(value, nn.Module):
        return {"module": type(value).__name__, "weights": _digest_of(value)}
    if is_dataclass(value) and not isinstance(value, type):
        name = getattr(type(value), "name", None)
        by_name = {one.name: getattr(value, one.name) for one in fields(value) if not one.name.startswith("_")}
        return plain_data({"name": name, **by_name} if isinstance(name, str) else by_name)
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return plain_data(value._asdict())
    if isinstance(value, Mapping):
        return {str(key): plain_data(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain_data(item) for item in value]
    if isinstance(value, np.generic):
        return plain_data(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _digest_of(module: nn.Module) -> str:
    """The weights of a module, in short."""
    digest = hashlib.blake2b(digest_size=16)
    for name, weight in sorted(module.state_dict().items()):
        digest.update(name.encode())
        digest.update(weight.detach().cpu().contiguous().flatten().view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def versions() -> dict[str, str | None]:
    """Versions of what takes part; Open3D's is ``None`` as long as nothing has loaded it."""
    open3d = sys.modules.get("open3d")
    return {
        "torchreg": __version__,
        "torch": torch.__version__,
        "numpy": np.__version__,
        "open3d": getattr(open3d, "__version__", None),
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.release()} {platform.machine()}",
    }


def _pose(T: Tensor | None) -> dict[str, object]:
    """A transform (4, 4) as matrix, quaternion and translation; without one ``None`` under the same keys."""
    if T is None:
        return dict.fromkeys(("T_target_source", "quaternion", "translation"))
    quaternion = quaternion_wxyz(T[:3, :3].cpu()).tolist()
    return {"T_target_source": T, "quaternion": dict(zip("wxyz", quaternion, strict=True)), "translation": T[:3, 3]}


def number_or_matrix(values: Tensor | None, pair: int) -> object:
    """The pair's number or matrix; ``None`` where it was not computed, or is a matrix that is not finite."""
    if values is None:
        return None
    value = values[pair].detach().cpu()
    return value.tolist() if value.ndim == 0 or bool(torch.isfinite(value).all()) else None
