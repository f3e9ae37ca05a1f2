"""Tables for a terminal: a registration, a cloud file, the summary of a batch."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import torch
from rich.table import Table
from rich.text import Text
from torch import Tensor

from torchreg.batch.summary import Summary
from torchreg.io import CloudFile
from torchreg.metrics import PoseErrors
from torchreg.registration.options import RegistrationOptions
from torchreg.report.explain.explanation import (
    axis_strength_text,
    deviations_text,
    meaning_of_strength,
    residuals_line,
    residuals_text,
    runner_up_text,
)
from torchreg.report.explain.facts import Facts, facts_of
from torchreg.report.explain.given import deviation_text, rival_text
from torchreg.report.text import chance, counted, distance, meters, plain, share
from torchreg.types import RegistrationResult, Verification


def registration_table(
    result: RegistrationResult,
    pair: int = 0,
    *,
    source: str,
    target: str,
    truth: PoseErrors | None = None,
    file_notes: Iterable[str] = (),
) -> Table:
    """One pair of a result: its clouds, derived numbers, counts, fit, certainty, times, notes and verdict.

    Args:
        result: of B pairs.
        pair: which one.
        source: text that names the source cloud, such as its file and size.
        target: likewise.
        truth: errors of the pose, trusted or not, under the true transform, where that is known.
        file_notes: what reading the clouds showed.

    Example:
        >>> import torchreg as tr
        >>> from torchreg.report import registration_table
        >>> pair = tr.datasets.mall(seed=1, angular_step=4.0)
        >>> result = tr.register(pair.source, pair.target, effort="plain")
        >>> registration_table(result, source="a.ply", target="b.ply").row_count > 5
        True
    """
    facts = facts_of(result, pair)
    table = _table((("source", source), ("target", target)))
    if facts.options is not None:
        _add(table, _options_rows(facts.options, colored=facts.colored))
    _add(table, _registration_rows(facts))
    _add(table, _time_and_notes(result, (*file_notes, *facts.notes)))
    if truth is not None:
        rre, rte, rmse = truth
        pose = "" if facts.success else "the likeliest pose, which was refused: "
        table.add_row("against the truth", f"{pose}RRE {rre:.4g} degrees, RTE {distance(rte)}, RMSE {distance(rmse)}")
    if facts.success:
        table.add_row("T_target_source", Text(matrix_text(result.T_target_source[pair]), no_wrap=True))
        table.add_row("verdict", Text("registered", style="bold green"))
    else:
        table.add_row("verdict", Text("not registered: ", style="bold red") + plain(result.reason[pair]))
    return table


def verification_table(
    result: Verification,
    pair: int = 0,
    *,
    source: str,
    target: str,
    given: str,
    file_notes: Iterable[str] = (),
) -> Table:
    """The verdict on one given transform: its fit, where it settles, its rival, certainty, and a better one if any.

    Args:
        result: of B pairs.
        pair: which one.
        source: text that names the source cloud, such as its file and size.
        target: likewise.
        given: text that names the transform, such as its file.
        file_notes: what reading the clouds showed.

    Example:
        >>> import torchreg as tr
        >>> from torchreg.report import verification_table
        >>> pair = tr.datasets.mall(seed=1, angular_step=3.0)
        >>> verification = tr.verify(pair.source, pair.target, pair.T_target_source)
        >>> verification_table(verification, source="a.ply", target="b.ply", given="T.txt").row_count > 5
        True
    """
    facts = facts_of(result.search, pair)
    table = _table((("source", source), ("target", target), ("transform", given)))
    if facts.options is not None:
        _add(table, _options_rows(facts.options, colored=facts.colored))
    if result.candidate[pair] is not None:
        _add(table, _verification_rows(result, pair))
    _add(table, _time_and_notes(result.search, (*file_notes, *facts.notes)))
    if not result.success[pair] and facts.success:
        table.add_row("better", Text(matrix_text(result.likeliest[pair]), no_wrap=True))
    if result.success[pair]:
        table.add_row("settled", Text(matrix_text(result.settled[pair]), no_wrap=True))
        table.add_row("verdict", Text("right", style="bold green"))
    else:
        table.add_row("verdict", Text("not right: ", style="bold red") + plain(result.reason[pair]))
    return table


def cloud_table(file: CloudFile, spacing: float, options: RegistrationOptions | None, defect: str) -> Table:
    """A cloud's file, its size and scale, and the options that ``register`` would derive from it.

    Args:
        file: as ``read_cloud_report`` returns it.
        spacing: meters between neighboring points.
        options: derived for a pair of such clouds; ``None`` where nothing can be derived.
        defect: why the cloud cannot be registered, or an empty text.

    Example:
        >>> import torch, torchreg as tr
        >>> from torchreg.report import cloud_table
        >>> tr.write_cloud("a.ply", tr.Clouds(torch.rand(100, 3)))
        >>> file = tr.io.read_cloud_report("a.ply")
        >>> type(cloud_table(file, float(tr.spacing(file.cloud)), None, "")).__name__
        'Table'
    """
    dropped = f" ({file.dropped_non_finite:,} with NaN or infinity dropped)" if file.dropped_non_finite else ""
    table = _table(
        (
            ("file", file.path),
            ("format", file.format),
            *((("scan", file.scan),) if file.scan else ()),
            ("points", f"{file.points_in_file:,} in the file{dropped}"),
            ("extent", " x ".join(f"{edge:.4g}" for edge in file.extent) + " m"),
            ("origin", ", ".join(f"{value:.9g}" for value in file.cloud.origin[0].tolist()) + " m"),
            ("colors", f"yes, {file.color_depth}" if file.has_colors else "no"),
            *((("intensity", "yes"),) if file.intensity is not None else ()),
            ("normals", "yes" if file.has_normals else "no"),
            ("viewpoint", file.viewpoint_source),
            ("spacing", meters(spacing) + " (median distance to the fourth neighbor)"),
            *(("note", note) for note in file.notes),
        )
    )
    if options is not None:
        table.add_row()
        table.add_row("default options", "for a pair of clouds like this one")
        _add(table, _options_rows(options, colored=file.has_colors))
    if defect:
        table.add_row("cannot be registered", plain(defect))
    return table


def summary_table(summary: Summary) -> Table:
    """Counts, errors and times of a batch, and the pairs to inspect first.

    Example:
        >>> from torchreg.batch.summary import summarize
        >>> from torchreg.report import summary_table
        >>> type(summary_table(summarize([], [], {}))).__name__
        'Table'
    """
    table = _table(_summary_rows(summary))
    for place, (name, trouble) in enumerate(summary.worst):
        table.add_row("worst pairs" if place == 0 else "", plain(f"{name}: {trouble}"))
    return table


def matrix_text(T: Tensor) -> str:
    """A transform (4, 4) as four lines; ``write_transform_text`` keeps every digit.

    The translation is given to the micrometer, the rotation with so many digits that points thousands of kilometers
    from the zero, as on a map, stay within 0.1 mm.

    Example:
        >>> import torch, torchreg as tr
        >>> from torchreg.report import matrix_text
        >>> len(matrix_text(torch.eye(4, dtype=torch.float64)).splitlines())
        4
    """
    cells = [[*(f"{value:.11f}" for value in row[:3]), f"{row[3]:.6f}"] for row in T.tolist()]
    widths = [max(len(row[column]) for row in cells) for column in range(4)]
    return "\n".join(" ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in cells)


def _table(rows: Iterable[tuple[str, str]]) -> Table:
    """Names and values in two columns, without lines; long values are folded, never cut."""
    table = Table.grid(padding=(0, 2))
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    _add(table, rows)
    return table


def _add(table: Table, rows: Iterable[tuple[str, str]]) -> None:
    for name, value in rows:
        table.add_row(name, plain(value))


def _options_rows(options: RegistrationOptions, *, colored: bool) -> Iterator[tuple[str, str]]:
    """The options that a user would ask about; without colors the descriptors that need them take no part."""
    voxel = options.voxel_size
    yield "voxel size", "none: points as they are" if voxel is None else meters(voxel)
    yield "normals", f"within {meters(options.normal_radius)}, at most {options.normal_max_neighbors} neighbors"
    for record, weight in zip(options.descriptors, options.weights, strict=True):
        if colored or not record.needs_colors:
            within = f"within {meters(record.radius)}, at most {record.max_neighbors} neighbors"
            yield record.name, f"{within}, weight {weight:g}"
    if not (colored and any(record.needs_colors for record in options.descriptors)):
        yield "color", "none: geometry alone"
    if options.keypoints is not None:
        yield "keypoints", f"{options.keypoints.name}: no other points are matched"
    yield "inlier threshold", meters(options.inlier_threshold)


def _registration_rows(facts: Facts) -> Iterator[tuple[str, str]]:
    """Counts and fit; overlap and certainty only where the pose was weighed on the clouds."""
    yield "matches", f"{facts.matches:,}"
    yield "hypotheses", f"{facts.drawn:,} drawn, {facts.kept:,} kept by the first test, {facts.scored:,} scored"
    yield "inliers", share(facts.inliers, facts.matches)
    yield "fitness", f"{facts.fitness:.4f} of the source points near the target"
    yield "inlier_rmse", meters(facts.inlier_rmse)
    if facts.overlap is not None:
        yield "overlap", f"{facts.overlap:.4f} of the points have a partner"
    if facts.residuals is not None:
        yield "residuals", residuals_text(facts)
    if facts.deviations is not None:
        yield "deviation of pose", deviations_text(facts)
    if facts.axis_strength is not None:
        yield "strength by axis", axis_strength_text(facts)
    if facts.strength is not None:
        yield "strength", f"{facts.strength:.3f} of 1: {meaning_of_strength(facts.strength)}"
    if facts.margin is not None or facts.apart is not None:
        yield "runner-up", runner_up_text(facts)
    if facts.probability is not None:
        yield "probability", f"{chance(facts.probability)} that the pose is right"


def _verification_rows(result: Verification, pair: int) -> Iterator[tuple[str, str]]:
    """Fit and overlap at the given transform, then where it settles and what rivals it."""
    yield "fitness", f"{float(result.fitness[pair]):.4f} of the source points near the target"
    yield "inlier_rmse", meters(float(result.inlier_rmse[pair]))
    yield "overlap", f"{float(result.overlap[pair]):.4f} of the points have a partner"
    if bool(torch.isfinite(result.residual_95[pair])):
        yield "residuals", residuals_line(*(float(value[pair]) for value in _residuals_of(result)))
    yield "settles", deviation_text(result, pair)
    yield "rival", rival_text(result, pair)
    yield "probability", f"{chance(float(result.probability[pair]))} that the transform is right"


def _residuals_of(result: Verification) -> tuple[Tensor, Tensor, Tensor]:
    return result.residual_median, result.residual_rms, result.residual_95


def _time_and_notes(result: RegistrationResult, notes: Iterable[str]) -> Iterator[tuple[str, str]]:
    if result.seconds:
        total = sum(seconds for _, seconds in result.seconds)
        stages = ", ".join(f"{name} {seconds:.2f} s" for name, seconds in result.seconds)
        yield "time", f"{total:.2f} s: {stages}"
    for note in notes:
        yield "note", note


def _summary_rows(summary: Summary) -> Iterator[tuple[str, str]]:
    yield "batch", f"{counted(summary.pairs, 'pair')} of {counted(summary.clouds, 'cloud')}"
    yield "registered", share(summary.registered, summary.pairs)
    yield "refused", share(summary.refused, summary.pairs)
    if summary.unreadable:
        yield "not readable", share(summary.unreadable, summary.pairs)
    if summary.broken:
        yield "failed by a defect", share(summary.broken, summary.pairs)
    if summary.with_truth:
        yield "recall", f"{share(summary.recalled, summary.with_truth)} of those with a truth"
        yield "wrong, called right", f"{summary.wrong_registered:,}"
        yield "right, refused", f"{summary.right_refused:,}"
    if summary.rre_degrees is not None and summary.rte_meters is not None:
        yield "median errors", f"RRE {summary.rre_degrees:.3g} degrees, RTE {distance(summary.rte_meters)}"
    total = sum(summary.seconds.values())
    if total > 0:
        stages = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in summary.seconds.items())
        yield "work", f"{total:.1f} s over all workers: {stages}"
