"""This library's own ways: the default at every effort, the paper's rule, and FPFH alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torchreg as tr
from torchreg.benchmark.peers.method import Answer, Matched, Method, Task
from torchreg.registration import options_for
from torchreg.registration.describe import downsample

Options = Callable[[Task], tr.RegistrationOptions]


def fpfh_alone(task: Task) -> tr.RegistrationOptions:
    """FPFH, mutual matches, RANSAC: the procedure that Open3D has too."""
    return replace(options_for(task.voxel, colored=False), effort="plain", solver="ransac")


def paper_rule(task: Task) -> tr.RegistrationOptions:
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
    return options_for(task.voxel, colored=_colored(task))


def _method(name: str, title: str, statement: str, options: Options, effort: str | None = None) -> Method:
    def run(task: Task) -> Answer:
        source, target = task.source.to(task.device), task.target.to(task.device)
        result = tr.register(source, target, options(task), effort=effort, seed=task.seed)
        # fast thins the clouds once more: its matches speak of those points
        used = [downsample(cloud, result.options).to("cpu") for cloud in (source, target)]
        return Answer(
            T_target_source=result.T_target_source[0].cpu(),
            success=bool(result.success[0]),
            matches=Matched(used[0], used[1], _on_cpu(result.correspondences)),
        )

    return Method(name=name, title=title, statement=statement, run=run)


def _on_cpu(matches: tr.Correspondences) -> tr.Correspondences:
    return tr.Correspondences(matches.source.cpu(), matches.target.cpu(), matches.offsets.cpu(), matches.score.cpu())


def _colored(task: Task) -> bool:
    return task.source.colors is not None and task.target.colors is not None


_EFFORT = "FPFH and color, compatibility graph, poses weighed on the clouds and refined by ICP"

OURS = (
    _method("default", "torchreg, balanced (default)", f"{_EFFORT}.", _default, "balanced"),
    _method("fast", "torchreg, fast", f"{_EFFORT}; lengths half as large again.", _default, "fast"),
    _method("thorough", "torchreg, thorough", f"{_EFFORT}; also RANSAC of 600,000 hypotheses.", _default, "thorough"),
    _method(
        "paper",
        "torchreg, the paper's preset",
        "FPFH + PCFH of hue equalized per cloud, RANSAC of at most 600,000 hypotheses, confidence 0.999.",
        paper_rule,
    ),
    _method(
        "fpfh",
        "torchreg, FPFH alone",
        "FPFH, RANSAC of at most 600,000 hypotheses, confidence 0.999.",
        fpfh_alone,
    ),
)
