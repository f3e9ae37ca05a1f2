"""The summary of a batch for a terminal."""

from __future__ import annotations

from collections.abc import Iterator

from rich.table import Table

from torchreg.batch.summary import Summary
from torchreg.report.text import meters, plain, share, two_columns


def summary_table(summary: Summary) -> Table:
    """Counts, errors, times and the pairs to look at first."""
    table = two_columns()
    for name, value in summary_rows(summary):
        table.add_row(name, plain(value))
    for place, (name, trouble) in enumerate(summary.worst):
        table.add_row("worst pairs" if place == 0 else "", plain(f"{name}: {trouble}"))
    return table


def summary_rows(summary: Summary) -> Iterator[tuple[str, str]]:
    """Name and value of every figure but the worst pairs."""
    yield "pairs", f"{summary.pairs:,} of {summary.clouds:,} clouds"
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
        yield "median errors", f"RRE {summary.rre_degrees:.3g} degrees, RTE {meters(summary.rte_meters)}"
    total = sum(summary.seconds.values())
    if total > 0:
        stages = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in summary.seconds.items())
        yield "work", f"{total:.1f} s over all workers: {stages}"
