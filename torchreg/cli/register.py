"""``torchreg register``: find the transform between two files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import typer

from torchreg.cli import options as opt
from torchreg.cli.device import use
from torchreg.cli.expand import expanded
from torchreg.cli.guard import NOT_REGISTERED, complain
from torchreg.cli.output import STANDARD_OUTPUT, Output, check_outputs, standard_output, write_json
from torchreg.cli.overrides import Overrides, options_for
from torchreg.cli.pair import PairInput, ReadPair, read_pair
from torchreg.cli.progress import step
from torchreg.metrics import pose_errors
from torchreg.registration.register import register as register_clouds
from torchreg.report import FIGURE_SUFFIXES
from torchreg.types import RegistrationResult


@dataclass(frozen=True, kw_only=True)
class Outputs:
    """The files that ``register`` writes where they are asked for."""

    json: opt.JsonFile = None
    transform: opt.TransformFile = None
    aligned: opt.AlignedFile = None
    figure: opt.FigureFile = None
    matches: opt.MatchesFile = None

    def check(self, inputs: list[Path]) -> None:
        """See before the work begins that all of them can be written."""
        outputs = (
            Output("--json", self.json),
            Output("--transform", self.transform),
            Output("--aligned", self.aligned, (".ply", ".npz")),
            Output("--figure", self.figure, FIGURE_SUFFIXES),
            Output("--matches", self.matches, FIGURE_SUFFIXES),
        )
        check_outputs(outputs, inputs)


@expanded
def register(
    pair_input: PairInput,
    overrides: Overrides,
    outputs: Outputs,
    effort: opt.EffortName = None,
    solver: opt.SolverName = None,
    explain: opt.ExplainSwitch = False,
    device: opt.DeviceName = opt.Device.cpu,
    threads: opt.Threads = None,
) -> None:
    """Find the rigid transform that brings SOURCE onto TARGET: x_target = R x_source + t, in meters.

    No first guess is needed. Exit code 0: registered. 2: bad usage or an unreadable file. 3: not registered, with
    the reason; no transform and no aligned cloud is written then.
    """
    from torchreg.io import result_to_dict
    from torchreg.report import registration_table
    from torchreg.report.text import plain

    outputs.check(pair_input.paths)
    where = use(device, threads)
    T_true = pair_input.transform()
    pair, seed = read_pair(pair_input), pair_input.seed
    with step(f"registering {pair_input.source.name} to {pair_input.target.name}"):
        one, other = pair.used[0].to(where), pair.used[1].to(where)
        options = options_for(one, other, overrides)
        result = register_clouds(
            one,
            other,
            options,
            effort=None if effort is None else effort.value,
            solver=None if solver is None else solver.value,
            seed=seed,
        )
    success, reason = bool(result.success[0]), result.reason[0]
    errors = pose_errors(pair.whole[0], T_true, result.T_target_source[0]) if T_true is not None and success else None

    if outputs.json is not None:
        content = result_to_dict(result, seed=seed, source=str(pair_input.source), target=str(pair_input.target))
        run = {"preset": overrides.preset.value, **pair_input.run(), "device": device.value}
        found = None if errors is None else errors._asdict()
        write_json(outputs.json, {**content, "points": pair.counts(), "run": run, "truth": found})
    _write_clouds(outputs, pair, result)
    _draw(outputs, pair, result, f"{pair_input.source.name} to {pair_input.target.name}")
    if outputs.json == STANDARD_OUTPUT:
        complain("registered" if success else f"not registered: {reason}")
    else:
        words = pair.words
        table = registration_table(result, source=words[0], target=words[1], truth=errors)
        standard_output().print(table)
    if explain:
        console = standard_output(stderr=outputs.json == STANDARD_OUTPUT)
        console.print("", plain(result.explain()), sep="\n", soft_wrap=True)
    if not success:
        raise typer.Exit(NOT_REGISTERED)


def _write_clouds(outputs: Outputs, pair: ReadPair, result: RegistrationResult) -> None:
    """The transform and the source under it, of a pair that was registered."""
    from torchreg.io import write_cloud, write_transform_text

    if not bool(result.success[0]):
        return
    T = result.T_target_source[0].cpu()
    if outputs.transform is not None:
        write_transform_text(outputs.transform, T)
    if outputs.aligned is not None:
        with step(f"writing {outputs.aligned.name}"):
            write_cloud(outputs.aligned, pair.whole[0], T=T)


def _draw(outputs: Outputs, pair: ReadPair, result: RegistrationResult, names: str) -> None:
    from torchreg.report import correspondence_figure, registration_figure, save_figure

    success = bool(result.success[0])
    title = f"{names}: " + ("registered" if success else f"not registered, {result.reason[0]}")
    if outputs.figure is not None:
        with step(f"drawing {outputs.figure.name}"):
            T = result.T_target_source[0].cpu() if success else None
            save_figure(registration_figure(*pair.whole, T, title=title), outputs.figure)
    if outputs.matches is not None:
        with step(f"drawing {outputs.matches.name}"):
            save_figure(correspondence_figure(*pair.used, result, title=title), outputs.matches)
