"""A page of HTML on a site, in a single file that opens without a network."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import torch

from torchreg.errors import at_least, expect
from torchreg.io.atomic import write_text
from torchreg.io.result_json import versions
from torchreg.report.page import markup
from torchreg.report.page.report import REPORT_SUFFIXES, page_html
from torchreg.report.page.site_frame import GroupFrame, group_frame
from torchreg.report.page.site_plan import CONTRADICTED, site_plan
from torchreg.report.page.site_space import site_space
from torchreg.report.site_text import doubts, missing_lines, verdict_lines
from torchreg.report.text import chance, counted, decimal, distance, millimeters
from torchreg.site.result import SiteLink, SiteResult
from torchreg.types import Clouds

_SHOWN = 20  # rows of a table; the others are folded

_LISTED = 5000  # pairs without a link
_DRAWN = 4  # groups, the largest first


class ReportedSite(NamedTuple):
    """A site with what its page is told beside it."""

    site: SiteResult
    scans: Sequence[Clouds]
    names: Sequence[str]
    max_points: int
    frames: Sequence[GroupFrame]
    """Of the groups that are drawn, the largest first."""


def write_site_report(
    path: str | os.PathLike[str],
    site: SiteResult,
    scans: Sequence[Clouds],
    *,
    names: Sequence[str] | None = None,
    max_points: int = 1_000_000,
) -> None:
    """Write a page on a site to a file, in full or not at all: verdict, scans, links with their reasons, and a 3D view.

    Args:
        path: a name that ends in ``.html`` or ``.htm``, in a folder that exists.
        site: of N scans.
        scans: the scans that were registered, each a batch of one.
        names: of the scans; numbers by default.
        max_points: of all scans together in the 3D view.

    Raises:
        ValueError: another suffix, no such folder, another number of scans or names, or a count below 1.

    Example:
        >>> import torchreg as tr
        >>> from torchreg.report import write_site_report
        >>> scans = tr.synthetic.building(seed=3, scans=5, floors=1, angular_step=3.0).scans
        >>> write_site_report("site.html", tr.register_site(scans), scans, max_points=10_000)
    """
    suffix = Path(path).suffix.lower()
    expect(suffix in REPORT_SUFFIXES, "path", "a name that ends in " + " or ".join(REPORT_SUFFIXES), os.fspath(path))
    write_text(path, site_report_html(site, scans, names=names, max_points=max_points))


def site_report_html(
    site: SiteResult, scans: Sequence[Clouds], *, names: Sequence[str] | None = None, max_points: int = 1_000_000
) -> str:
    """The page; arguments and errors as of ``write_site_report``.

    Example:
        >>> import torchreg as tr
        >>> from torchreg.report import site_report_html
        >>> scans = tr.synthetic.building(seed=3, scans=5, floors=1, angular_step=3.0).scans
        >>> site_report_html(tr.register_site(scans), scans, max_points=10_000)[:15]
        '<!DOCTYPE html>'
    """
    at_least(max_points, "max_points", 1)
    labels = [f"scan {number}" for number in range(len(site))] if names is None else list(names)
    for name, given in (("scans", scans), ("names", labels)):
        expect(len(given) == len(site), name, f"one per scan ({len(site)})", len(given))
    frames = [group_frame(site, scans, group) for group in range(min(int(site.group.max()) + 1, _DRAWN))]
    reported = ReportedSite(site, scans, labels, max_points, frames)
    return page_html(f"torchreg: a site of {counted(len(site), 'scan')}", [make(reported) for make in SITE_SECTIONS])


def verdict(reported: ReportedSite) -> str:
    """What is placed."""
    site = reported.site
    first, *more = verdict_lines(site)
    whole = bool(site.placed.all()) and int(site.group.max()) == 0
    sentence = markup.paragraph(first[0].upper() + first[1:] + ".", "registered" if whole else "refused")
    return markup.section("Verdict", sentence, *(markup.paragraph(line[0].upper() + line[1:] + ".") for line in more))


def attention(reported: ReportedSite) -> str:
    """What to look at first."""
    plain = [f"scan {number}" for number in range(len(reported.names))]
    names = [one if name == one else f"{one} ({name})" for one, name in zip(plain, reported.names, strict=True)]
    lines = [*missing_lines(reported.site, names), *doubts(reported.site, names)]
    return markup.section("What to look at first", markup.listing(lines))


def plan(reported: ReportedSite) -> str:
    """The graph of scans from above, group by group."""
    site = reported.site
    missing = (site.group < 0).nonzero()[:, 0].tolist()
    plans = [
        markup.paragraph(f"Group {group}", "title") * (len(reported.frames) > 1)
        + site_plan(site, frame, reported.scans, reported.names, missing if group == 0 else ())
        for group, frame in enumerate(reported.frames)
    ]
    return markup.section("Plan", *plans)


def space(reported: ReportedSite) -> str:
    """The placed scans in 3D."""
    view = site_space(reported.site, reported.frames, reported.scans, reported.names, reported.max_points)
    return markup.section("The scans in 3D", view)


def scans(reported: ReportedSite) -> str:
    """A row for every scan."""
    site = reported.site
    used = [0] * len(site)
    loops = [0] * len(site)
    for one in site.links:
        for scan in (one.link.source, one.link.target) if one.used else ():
            used[scan] += 1
            loops[scan] += one.loops > 0
    deviation = site.covariance[:, 3:, 3:].diagonal(dim1=1, dim2=2).sum(dim=1).sqrt().tolist()
    rows = [
        (
            str(number),
            reported.names[number],
            f"{len(cloud.points):,}",
            str(group) if group >= 0 else "",
            str(used[number]),
            str(loops[number]),
            distance(deviation[number]) if group >= 0 else "",
            site.reason[number],
        )
        for number, (cloud, group) in enumerate(zip(reported.scans, site.group.tolist(), strict=True))
    ]
    headings = ("", "scan", "points", "group", "links", "in loops", "deviation", "why not placed")
    width = len(headings) - bool(site.placed.all())
    return markup.section("Scans", _table(headings[:width], [row[:width] for row in rows]))


def notes(reported: ReportedSite) -> str:
    """Remarks on scans, each once."""
    scans_of: dict[str, list[str]] = {}
    for number, own in enumerate(reported.site.notes):
        for note in own:
            scans_of.setdefault(note, []).append(str(number))
    count = len(reported.site)
    lines = [
        f"{'all scans' if len(those) == count else 'scans ' + ', '.join(those)}: {note}"
        for note, those in scans_of.items()
    ]
    return markup.section("Notes on the scans", markup.listing(lines))


def links(reported: ReportedSite) -> str:
    """The links that hold the scans, those that fit the worst first."""
    used = [one for one in reported.site.links if one.used]
    used.sort(key=lambda one: (-(one.meters if one.meters == one.meters else 0.0), one.link.target, one.link.source))
    headings = (
        *("scans", "probability", "overlap", "residual", "deviation along x, y, z", "off by", "turned by", "loops"),
        *("loop error", "alone"),
    )
    text = (
        "Poses that agree with each other, those that fit the worst first. Deviation: how well the surfaces of the "
        "overlap hold the shift along the axes of the views above; the largest is where the link is weak. Off by and "
        "turned by: between the link and the poses of all. Loop error: by how much loops of three links miss closing, "
        "their median. Alone: the verdict on the pair without its neighbors."
    )
    rows = [_link_row(one, reported) for one in used]
    return markup.section("Links", markup.paragraph(text), _table(headings, rows)) if rows else ""


def refused(reported: ReportedSite) -> str:
    """Pairs that no used link joins, with their reasons."""
    site = reported.site
    joined = {(one.link.source, one.link.target) for one in site.links if one.used}
    rows = [
        (
            _pair(pair.source, pair.target),
            pair.reason or CONTRADICTED,
            str(pair.candidates),
        )
        for pair in site.pairs
        if (pair.source, pair.target) not in joined
    ]
    rows.sort(key=lambda row: tuple(map(int, row[0].split(" - "))))
    if not rows:
        return ""
    table = markup.columns(("scans", "reason", "candidates"), rows[:_LISTED])
    more = f", the first {_LISTED:,}; site.json has all" if len(rows) > _LISTED else ""
    heading = f"{counted(len(rows), 'pair')} of scans without a link{more}"
    return markup.section("Other pairs", markup.folded(heading, table))


def run(reported: ReportedSite) -> str:
    """Versions; no times, so that the same run gives the same page."""
    known = [(name, value) for name, value in versions().items() if value is not None]
    return markup.section("Versions", markup.named_rows(known))


SITE_SECTIONS: tuple[Callable[[ReportedSite], str], ...] = (
    *(verdict, attention, plan, space, scans),
    *(links, refused, notes, run),
)
"""From top to bottom."""


def _link_row(one: SiteLink, reported: ReportedSite) -> tuple[str, ...]:
    link = one.link
    return (
        _pair(link.source, link.target),
        chance(link.probability),
        decimal(link.overlap),
        distance(link.residual) if link.residual == link.residual else "",
        _strength(one, reported),
        distance(one.meters),
        _degrees(one.degrees),
        str(one.loops) if one.loops else "",
        f"{distance(one.loop_meters)}, {_degrees(one.loop_degrees)}" if one.loops else "",
        link.reason.partition(":")[0] or ("registered" if link.rank == 0 else f"candidate {link.rank + 1}"),
    )


def _strength(one: SiteLink, reported: ReportedSite) -> str:
    """The deviations of a link's shift along the axes of the page."""
    group = int(reported.site.group[one.link.target])
    if not 0 <= group < len(reported.frames):
        return ""
    turn = torch.from_numpy(reported.frames[group].axes) @ reported.site.T_world_scan[one.link.target, :3, :3]
    deviations = (turn @ one.link.covariance[3:, 3:] @ turn.t()).diagonal().sqrt().tolist()
    return millimeters(*deviations) if max(deviations) < 1 else ", ".join(map(distance, deviations))


def _degrees(value: float) -> str:
    return f"{value:.2g}°" if value >= 5e-4 else "0°"


def _pair(source: int, target: int) -> str:
    low, high = sorted((source, target))
    return f"{low} - {high}"


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    rest = rows[_SHOWN:]
    folded = markup.folded(f"{len(rest):,} more", markup.columns(headings, rest)) if rest else ""
    return markup.columns(headings, rows[:_SHOWN]) + folded
