"""What a registration found, as a table for a terminal."""

from __future__ import annotations

from collections.abc import Iterator

from rich.table import Table
from rich.text import Text
from torch import Tensor

from torchreg.metrics import PoseErrors
from torchreg.report.explain.facts import facts_of
from torchreg.report.explain.verdict import meaning_of_strength, runner_up_words
from torchreg.report.explain.words import chance
from torchreg.report.options_rows import options_rows
from torchreg.report.text import meters, plain, share, two_columns
from torchreg.types import RegistrationResult
from torchreg.types.packing import spans


def registration_table(
    result: RegistrationResult,
    pair: int = 0,
    *,
    source: str,
    target: str,
    colored: bool = True,
    truth: PoseErrors | None = None,
) -> Table:
    """One pair of a result: its clouds, derived numbers, counts, fit, certainty, times, notes and verdict.

    Args:
        result: of B pairs.
        pair: which one.
        source: what to say of the source cloud, such as its file and size.
        target: what to say of the target cloud.
        colored: whether both clouds have colors.
        truth: errors under the true transform, where it is known.
    """
    table = two_columns()
    table.add_row("source", plain(source))
    table.add_row("target", plain(target))
    if result.options:
        for name, value in options_rows(result.options[pair], colored=colored):
            table.add_row(name, plain(value))
    begin, end = spans(result.correspondences.offsets)[pair]
    counts = {name: int(value[pair]) for name, value in result.hypotheses._asdict().items()}
    table.add_row("matches", f"{end - begin:,}")
    table.add_row("hypotheses", "{drawn:,} drawn, {kept:,} kept by the first test, {scored:,} scored".format(**counts))
    table.add_row("inliers", share(int(result.inliers[begin:end].sum()), end - begin))
    table.add_row("fitness", f"{float(result.fitness[pair]):.4f} of the source points near the target")
    table.add_row("inlier_rmse", meters(float(result.inlier_rmse[pair])))
    for name, value in _verified_rows(result, pair):
        table.add_row(name, plain(value))
    if result.seconds:
        total = sum(seconds for _, seconds in result.seconds)
        stages = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in result.seconds)
        table.add_row("time", f"{total:.2f} s: {stages}")
    for note in result.notes[pair] if result.notes else ():
        table.add_row("note", plain(note))
    if truth is not None:
        rre, rte, rmse = truth
        table.add_row("against the truth", f"RRE {rre:.4g} degrees, RTE {meters(rte)}, RMSE {meters(rmse)}")
    if bool(result.success[pair]):
        table.add_row("T_target_source", Text(matrix_text(result.T_target_source[pair]), no_wrap=True))
        table.add_row("verdict", Text("registered", style="bold green"))
    else:
        table.add_row("verdict", Text("not registered: ", style="bold red") + plain(result.reason[pair]))
    return table


def _verified_rows(result: RegistrationResult, pair: int) -> Iterator[tuple[str, str]]:
    """What weighing the pose on the clouds gave; nothing for a result made by a solver alone."""
    facts = facts_of(result, pair)
    if facts.overlap is not None:
        yield "overlap", f"{facts.overlap:.4f} of the points have a partner"
    if facts.strength is not None:
        yield "strength", f"{facts.strength:.3f} of 1: {meaning_of_strength(facts.strength)}"
    if facts.margin is not None or facts.apart is not None:
        yield "runner-up", runner_up_words(facts)
    if facts.probability is not None:
        yield "probability", f"{chance(facts.probability)} that the pose is right"


def matrix_text(T: Tensor) -> str:
    """A transform (4, 4) as four lines, to the nanometer; ``write_transform_text`` keeps every digit."""
    cells = [[f"{value:.9f}" for value in row] for row in T.tolist()]
    widths = [max(len(row[column]) for row in cells) for column in range(4)]
    return "\n".join(" ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in cells)
