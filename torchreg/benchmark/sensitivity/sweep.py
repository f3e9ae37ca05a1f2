"""The sweep: every variant on every pair, and what it changes against the paper's rule, pair by pair."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict

from torchreg.benchmark.bootstrap import bootstrap
from torchreg.benchmark.rows import Rows
from torchreg.benchmark.sensitivity.measure import Worth, described, worth
from torchreg.benchmark.sensitivity.variants import Variant, around, label
from torchreg.benchmark.tables import markdown_table
from torchreg.learning.prepared import PreparedPair

HEAD = ["choice", "value", "inlier ratio", "change against the center (95 %)", "found"]


def sweep(
    pairs: Sequence[PreparedPair],
    center: Variant,
    kept: Rows,
    *,
    report: Callable[[str], None] | None = None,
) -> dict[str, dict[str, list[Worth]]]:
    """The worth of every variant around ``center``, by axis and value, in the order of the pairs."""
    found: dict[str, dict[str, list[Worth]]] = {}
    for axis, variants in around(center).items():
        found[axis] = {}
        for variant in variants:
            key = label(getattr(variant, axis))
            found[axis][key] = [measured(pair, variant, kept) for pair in pairs]
            if report is not None:
                report(f"{axis} {key}")
    return found


def measured(pair: PreparedPair, variant: Variant, kept: Rows) -> Worth:
    """The worth of a variant on a pair, from the kept or anew."""
    key = f"{pair.name} {sorted(asdict(variant).items())}"
    return remembered(kept, key, lambda: worth(pair, described(pair, variant)))


def remembered(kept: Rows, key: str, measure: Callable[[], Worth]) -> Worth:
    """What was measured under this key, measured and kept now if it was not."""
    if key not in kept:
        kept.add({"key": key, **measure()._asdict()})
    row = kept[key]
    return Worth(row["inlier_ratio"], row["found"])


def sweep_table(found: dict[str, dict[str, list[Worth]]], center: Variant) -> str:
    """Markdown: the mean inlier ratio, its change against the center with an interval over pairs, and pairs found."""
    rows = []
    for axis, values in found.items():
        own = label(getattr(center, axis))
        for value, worths in values.items():
            change = bootstrap([a.inlier_ratio - b.inlier_ratio for a, b in zip(worths, values[own], strict=True)])
            hits = sum(one.found for one in worths)
            rows.append(
                [
                    axis.replace("_", " ") if value == next(iter(values)) else "",
                    f"**{value}**" if value == own else value,
                    f"{sum(one.inlier_ratio for one in worths) / len(worths):.3f}",
                    "" if value == own else f"{change.value:+.3f} ({change.low:+.3f} to {change.high:+.3f})",
                    f"{hits:g} / {len(worths)}",
                ]
            )
    return markdown_table(HEAD, rows)
