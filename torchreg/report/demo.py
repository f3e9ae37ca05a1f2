"""Several methods on one pair with known truth: a table, and one sentence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.table import Table
from torch import Tensor

from torchreg.metrics import PoseErrors

_TURNED_ROUND = 170.0  # degrees


@dataclass(frozen=True, eq=False, kw_only=True)
class DemoRow:
    """One method on one pair.

    Attributes:
        method: its name.
        points: of source and target that it worked on.
        inlier_ratio: share of its matches that are inliers under the truth.
        errors: of its transform under the truth.
        seconds: that it took.
        success: its own verdict.
        right: whether it succeeded, and its transform is the true one.
        T_target_source: (4, 4), its transform.

    Example:
        >>> import torch, torchreg as tr
        >>> from torchreg.report import DemoRow
        >>> errors = tr.metrics.PoseErrors(rre_degrees=0.1, rte_meters=0.02, rmse_meters=0.03)
        >>> figures = {"points": (900, 1000), "inlier_ratio": 0.2, "seconds": 0.5, "success": True, "right": True}
        >>> row = DemoRow(method="FPFH", errors=errors, T_target_source=torch.eye(4, dtype=torch.float64), **figures)
        >>> row.right
        True
    """

    method: str
    points: tuple[int, int]
    inlier_ratio: float
    errors: PoseErrors
    seconds: float
    success: bool
    right: bool
    T_target_source: Tensor


def demo_table(rows: Sequence[DemoRow]) -> Table:
    """A line for every method.

    Example:
        >>> import torch, torchreg as tr
        >>> from torchreg.report import DemoRow, demo_table
        >>> errors = tr.metrics.PoseErrors(rre_degrees=0.1, rte_meters=0.02, rmse_meters=0.03)
        >>> figures = {"points": (900, 1000), "inlier_ratio": 0.2, "seconds": 0.5, "success": True, "right": True}
        >>> row = DemoRow(method="FPFH", errors=errors, T_target_source=torch.eye(4, dtype=torch.float64), **figures)
        >>> demo_table([row]).row_count
        1
    """
    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("method", no_wrap=True)
    for name in ("points", "right\nmatches", "RRE\n(deg)", "RTE\n(m)", "RMSE\n(m)", "time\n(s)"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("result", no_wrap=True)
    for row in rows:
        verdict = "right" if row.right else "wrong"
        rre, rte, rmse = row.errors
        table.add_row(
            row.method,
            f"{max(row.points):,}",
            f"{100 * row.inlier_ratio:.2f} %",
            *((f"{rre:.3f}", f"{rte:.4f}", f"{rmse:.4f}") if row.success else ("-", "-", "-")),
            f"{row.seconds:.1f}",
            verdict if row.success else "refused",
        )
    return table


def demo_sentence(plain: DemoRow, fused: DemoRow) -> str:
    """One sentence that compares the plain procedure without color and the default on one hall.

    Example:
        >>> import torch, torchreg as tr
        >>> from torchreg.report import DemoRow, demo_sentence
        >>> errors = tr.metrics.PoseErrors(rre_degrees=0.1, rte_meters=0.02, rmse_meters=0.03)
        >>> figures = {"points": (900, 1000), "inlier_ratio": 0.2, "seconds": 0.5, "success": True, "right": True}
        >>> row = DemoRow(method="FPFH", errors=errors, T_target_source=torch.eye(4, dtype=torch.float64), **figures)
        >>> isinstance(demo_sentence(row, row), str)
        True
    """
    matches = f"{100 * fused.inlier_ratio:.1f} % of the matches are right instead of {100 * plain.inlier_ratio:.1f} %"
    if fused.right and plain.right:
        return f"The walls of both scans lie on each other by default and without color; with color {matches}."
    if fused.right:
        wrong = f"turned by {plain.errors.rre_degrees:.0f} degrees and moved by {plain.errors.rte_meters:.1f} m"
        if plain.errors.rre_degrees > _TURNED_ROUND:
            wrong += ", wall on wall but shops and furniture elsewhere"
        return f"Without color the plain procedure leaves one scan {wrong}; by default all coincides, and {matches}."
    other = "by the plain procedure without color they do" if plain.right else "nor by the plain procedure"
    return f"By default the walls of the two scans do not lie on each other, {other}; with color, {matches}."
