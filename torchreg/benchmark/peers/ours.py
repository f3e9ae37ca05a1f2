"""torchreg: the default at every effort, the paper's preset, and FPFH alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torchreg as tr
from torchreg.benchmark.peers.method import Answer, Method, PeerMatches, Task
from torchreg.registration.scale import scaled_options

Options = Callable[[Task], tr.RegistrationOptions]


def fpfh_alone(task: Task) -> tr.RegistrationOptions:
    """FPFH, mutual matches, RANSAC: the procedure that Open3D has too."""
    return replace(scaled_options(task.voxel, colored=False), effort="plain", solver="ransac")


def paper_preset(task: Task) -> tr.RegistrationOptions:
    """The paper's preset in its proportions 2 : 5 : 2 m at this voxel size, without PCFH where there is no color."""
    color = ("pcfh",) if _colored(task) else ()
    return replace(
        tr.PAPER,
        normal_radius=task.normal_radius,
        feature_radius=task.feature_radius,
        color=color,
        color_weights=(1.0,) * len(color),
        color_radius=task.normal_radius,
        ransac=replace(tr.PAPER.ransac, inlier_threshold=task.inlier_threshold),
    )


def _default(task: Task) -> tr.RegistrationOptions:
    return scaled_options(task.voxel, colored=_colored(task))


def _method(name: str, title: str, statement: str, options: Options, effort: str | None = None) -> Method:
    def run(task: Task) -> Answer:
        source, target = task.source.to(task.device), task.target.to(task.device)
        result = tr.register(source, target, options(task), effort=effort, seed=task.seed)
        return Answer(
            T_target_source=result.T_target_source[0].cpu(),
            success=bool(result.success[0]),
            matches=PeerMatches(result.source.to("cpu"), result.target.to("cpu"), _on_cpu(result.correspondences)),
        )

    return Method(name=name, title=title, statement=statement, run=run)


def _on_cpu(matches: tr.Correspondences) -> tr.Correspondences:
    return tr.Correspondences(matches.source.cpu(), matches.target.cpu(), matches.offsets, matches.score.cpu())


def _colored(task: Task) -> bool:
    return task.source.colors is not None and task.target.colors is not None


_EFFORT = "FPFH and color, compatibility graph, poses weighed on the clouds and refined by ICP"

METHODS = (
    _method("default", "torchreg, balanced (default)", f"{_EFFORT}.", _default, "balanced"),
    _method("fast", "torchreg, fast", f"{_EFFORT}; lengths half as large again.", _default, "fast"),
    _method("thorough", "torchreg, thorough", f"{_EFFORT}; also RANSAC of 600,000 hypotheses.", _default, "thorough"),
    _method(
        "paper",
        "torchreg, the paper's preset",
        "FPFH + PCFH of hue equalized per cloud, RANSAC of at most 600,000 hypotheses, confidence 0.999.",
        paper_preset,
    ),
    _method(
        "fpfh",
        "torchreg, FPFH alone",
        "FPFH, RANSAC of at most 600,000 hypotheses, confidence 0.999.",
        fpfh_alone,
    ),
)
