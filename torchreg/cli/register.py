"""``torchreg register``: find the transform between two files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchreg.cli import options as opt
from torchreg.cli.device import use
from torchreg.cli.guard import NOT_REGISTERED, complain
from torchreg.cli.output import STANDARD_OUTPUT, Output, check_outputs, standard_output, write_json
from torchreg.cli.overrides import Overrides, options_for
from torchreg.cli.pair import read_pair
from torchreg.cli.progress import step
from torchreg.registration import register as register_clouds

TransformFile = Annotated[
    Path | None,
    typer.Option(
        "--transform",
        metavar="FILE.txt",
        help="Write the transform as four lines of four numbers (translation in meters).",
        rich_help_panel="Output",
    ),
]
AlignedFile = Annotated[
    Path | None,
    typer.Option(
        "--aligned",
        metavar="FILE.ply",
        help="Write the whole source in the target's frame, coordinates in meters (.ply or .npz).",
        rich_help_panel="Output",
    ),
]
TruthFile = Annotated[
    Path | None,
    typer.Option(
        "--truth",
        metavar="FILE",
        help="The true transform, 4x4 text or JSON, in meters: adds the errors RRE (degrees), RTE and RMSE (meters).",
        rich_help_panel="Input",
    ),
]


def register(
    source: opt.Source,
    target: opt.Target,
    points: opt.Points = None,
    viewpoint: opt.ViewpointText = "auto",
    truth: TruthFile = None,
    preset: opt.PresetName = opt.Preset.default,
    voxel: opt.Voxel = None,
    normal_radius: opt.NormalRadius = None,
    feature_radius: opt.FeatureRadius = None,
    color_radius: opt.ColorRadius = None,
    inlier_threshold: opt.InlierThreshold = None,
    hypotheses: opt.Hypotheses = None,
    confidence: opt.Confidence = None,
    no_color: opt.NoColor = False,
    seed: opt.Seed = 0,
    device: opt.DeviceName = opt.Device.cpu,
    threads: opt.Threads = None,
    json: opt.JsonFile = None,
    transform: TransformFile = None,
    aligned: AlignedFile = None,
    figure: opt.FigureFile = None,
) -> None:
    """Find the rigid transform that brings SOURCE onto TARGET: x_target = R x_source + t, in meters.

    No first guess is needed. Exit code 0: registered. 2: bad usage or an unreadable file. 3: not registered, with
    the reason; no transform and no aligned cloud is written then.
    """
    from torchreg.io import read_transform_text, result_to_dict, write_cloud, write_transform_text
    from torchreg.report import FIGURE_SUFFIXES, registration_figure, registration_table, save_figure, truth_errors

    outputs = (
        Output("--json", json),
        Output("--transform", transform),
        Output("--aligned", aligned, (".ply", ".npz")),
        Output("--figure", figure, FIGURE_SUFFIXES),
    )
    check_outputs(outputs, [path for path in (source, target, truth) if path is not None])
    overrides = Overrides(
        voxel=voxel,
        normal_radius=normal_radius,
        feature_radius=feature_radius,
        color_radius=color_radius,
        inlier_threshold=inlier_threshold,
        hypotheses=hypotheses,
        confidence=confidence,
        no_color=no_color,
    )
    where = use(device, threads)
    T_true = None if truth is None else read_transform_text(truth)
    pair = read_pair(source, target, viewpoint=viewpoint, points=points, seed=seed)
    with step(f"registering {source.name} to {target.name}"):
        one, other = pair.used[0].to(where), pair.used[1].to(where)
        options = options_for(one, other, preset, overrides)
        result = register_clouds(one, other, options, seed=seed)
    T, success, reason = result.T_target_source[0].cpu(), bool(result.success[0]), result.reason[0]
    errors = None if T_true is None or not success else truth_errors(pair.whole[0], T_true, T)

    if success and transform is not None:
        write_transform_text(transform, T)
    if json is not None:
        content = result_to_dict(result, seed=seed, source=str(source), target=str(target))
        run = {"preset": preset.value, "points": points, "viewpoint": viewpoint, "device": device.value}
        found = None if errors is None else errors._asdict()
        write_json(json, {**content, "points": pair.counts(), "run": run, "truth": found})
    if success and aligned is not None:
        with step(f"writing {aligned.name}"):
            write_cloud(aligned, pair.whole[0], T=T)
    if figure is not None:
        verdict = f"{source.name} to {target.name}: " + ("registered" if success else f"not registered, {reason}")
        with step(f"drawing {figure.name}"):
            drawn = registration_figure(*pair.whole, T if success else None, title=verdict)
            save_figure(drawn, figure)
    if json == STANDARD_OUTPUT:
        complain("registered" if success else f"not registered: {reason}")
    else:
        words, colored = pair.words, pair.colored
        table = registration_table(result, source=words[0], target=words[1], colored=colored, truth=errors)
        standard_output().print(table)
    if not success:
        raise typer.Exit(NOT_REGISTERED)
