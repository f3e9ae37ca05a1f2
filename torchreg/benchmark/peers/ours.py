"""torchreg: the default at every effort, the paper's preset, and FPFH alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torchreg as tr
from torchreg.benchmark.peers.method import Answer, Method, PeerMatches, Task
from torchreg.registration import options_for


def fpfh_alone(task: Task) -> tr.RegistrationOptions:
    """FPFH, mutual matches, RANSAC: the procedure that Open3D has too."""
    solver = tr.RansacOptions(inlier_threshold=task.inlier_threshold)
    return replace(options_for(task.voxel, colored=False, effort="plain"), solver=solver)


def paper_preset(task: Task) -> tr.RegistrationOptions:
    """The paper's preset in its proportions 2 : 5 : 2 m at this voxel size."""
    return replace(
        tr.PAPER,
        normal_radius=task.normal_radius,
        descriptors=(tr.Fpfh(radius=task.feature_radius), tr.Pcfh(radius=task.normal_radius)),
        solver=tr.RansacOptions(inlier_threshold=task.inlier_threshold),
    )


def _at(effort: str) -> Callable[[Task], tr.RegistrationOptions]:
    def options(task: Task) -> tr.RegistrationOptions:
        colored = task.source.colors is not None and task.target.colors is not None
        return options_for(task.voxel, colored=colored, effort=effort)

    return options


def _method(name: str, title: str, statement: str, options: Callable[[Task], tr.RegistrationOptions]) -> Method:
    def run(task: Task) -> Answer:
        source, target = task.source.to(task.device), task.target.to(task.device)
        result = tr.register(source, target, options(task), seed=task.seed)
        rows = result.correspondences
        matches = tr.Correspondences(rows.source.cpu(), rows.target.cpu(), rows.offsets, rows.score.cpu())
        return Answer(
            T_target_source=result.T_target_source[0].cpu(),
            success=bool(result.success[0]),
            matches=PeerMatches(result.source.to("cpu"), result.target.to("cpu"), matches),
        )

    return Method(name=name, title=title, statement=statement, run=run)


_EFFORT = "FPFH and color, compatibility graph, poses weighed on the clouds and refined by ICP"

METHODS = (
    _method("default", "torchreg, balanced (default)", f"{_EFFORT}.", _at("balanced")),
    _method("fast", "torchreg, fast", f"{_EFFORT}; lengths half as large again.", _at("fast")),
    _method("thorough", "torchreg, thorough", f"{_EFFORT}; also RANSAC of 600,000 hypotheses.", _at("thorough")),
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
