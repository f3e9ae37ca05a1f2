"""The sections of a page, each a function from a pair to markup; one that has nothing to say returns nothing.

A section is added by writing its function and naming it in ``SECTIONS``.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import TYPE_CHECKING

from torchreg.geometry.se3 import quaternion_wxyz
from torchreg.io.result_json import plain_data, versions
from torchreg.report.correspondences import correspondence_figure
from torchreg.report.explain.advice import advice
from torchreg.report.explain.explanation import CANDIDATE_HEADINGS, candidate_cells, verdict_text
from torchreg.report.figures import registration_figure
from torchreg.report.page import markup
from torchreg.report.page.reported import ReportedPair
from torchreg.report.page.space import space_view
from torchreg.report.tables import matrix_text, registration_table
from torchreg.report.titles import picture_title

if TYPE_CHECKING:
    from rich.table import Table

_SHOWN = 10  # candidates; the others are folded

Section = Callable[[ReportedPair], str]


def verdict(reported: ReportedPair) -> str:
    """Whether the pair is registered and how sure that is, or why it was refused and what may help."""
    facts = reported.facts
    text = verdict_text(facts)
    sentence = markup.paragraph(text[0].upper() + text[1:], "registered" if facts.success else "refused")
    remedies = "" if facts.success else "<h3>What may help</h3>\n" + markup.listing(advice(facts))
    return markup.section("Verdict", sentence, remedies)


def space(reported: ReportedPair) -> str:
    """The clouds in 3D."""
    return markup.section("The clouds in 3D", space_view(reported))


def numbers(reported: ReportedPair) -> str:
    """The rows of the table that the command line prints."""
    words, truth = reported.words, reported.truth
    table = registration_table(reported.result, reported.pair, source=words[0], target=words[1], truth=truth)
    return markup.section("Numbers", markup.named_rows(_rows(table)))


def transform(reported: ReportedPair) -> str:
    """The transform as a matrix, and as a quaternion and a translation; of a refused pair its likeliest pose."""
    T = reported.pose
    if T is None:
        return ""
    name = "T_target_source" if reported.facts.success else "likeliest pose"
    quaternion = ", ".join(f"{value:.12f}" for value in quaternion_wxyz(T[:3, :3]).tolist())
    translation = ", ".join(f"{value:.9f}" for value in T[:3, 3].tolist())
    rows = [
        (name, matrix_text(T)),
        ("quaternion w, x, y, z", quaternion),
        ("translation x, y, z", f"{translation} (meters)"),
    ]
    meaning = "x_target = R x_source + t, in meters, in the frames of the files."
    refused = "" if reported.facts.success else markup.paragraph("This pose was refused; it is no result.", "refused")
    return markup.section("Transform", refused, markup.paragraph(meaning), markup.named_rows(rows))


def pictures(reported: ReportedPair) -> str:
    """The clouds from three sides before and after, and the matches."""
    success, heading = reported.facts.success, reported.heading
    title = picture_title(heading, reported.result, reported.pair)
    sides = registration_figure(*reported.clouds, reported.pose, title=title, refused=not success)
    states = "before registration"
    if reported.pose is not None:
        states = "before and after registration" if success else "before and under the likeliest pose, refused"
    matched = correspondence_figure(reported.source, reported.target, reported.result, reported.pair, title=title)
    facts = reported.facts
    return markup.section(
        "Pictures",
        markup.picture(sides, f"{heading}, {states}: both clouds from the top, the front and the side"),
        markup.picture(
            matched, f"{heading}: {facts.matches:,} matches as lines between them, {facts.inliers:,} inliers"
        ),
    )


def candidates(reported: ReportedPair) -> str:
    """Every pose that was weighed, best first."""
    weighed = reported.facts.candidates
    if not weighed:
        return ""
    rows = [candidate_cells(candidate) for candidate in weighed]
    best = markup.columns(CANDIDATE_HEADINGS, rows[:_SHOWN])
    rest = markup.columns(CANDIDATE_HEADINGS, rows[_SHOWN:]) if rows[_SHOWN:] else ""
    return markup.section("Candidates", best, rest and markup.folded(f"{len(rows[_SHOWN:]):,} more", rest))


def explanation(reported: ReportedPair) -> str:
    """What each stage kept and dropped."""
    return markup.section("What each stage did", markup.preformatted(reported.result.explain(reported.pair)))


def file_notes(reported: ReportedPair) -> str:
    """What reading the files showed."""
    return markup.section("Notes on the files", markup.listing(reported.file_notes))


def options(reported: ReportedPair) -> str:
    """All options, derived lengths included, and what computed the result."""
    parts = []
    if reported.facts.options is not None:
        text = json.dumps(plain_data(reported.facts.options), indent=2)
        parts.append(markup.folded("All options, lengths in meters", markup.preformatted(text)))
    known = {name: value for name, value in versions().items() if value is not None}
    return markup.section("Options and versions", *parts, markup.named_rows(known.items()))


SECTIONS: tuple[Section, ...] = (
    *(verdict, space, numbers, transform, pictures),
    *(candidates, explanation, file_notes, options),
)
"""From top to bottom."""


def _rows(table: Table) -> list[tuple[str, str]]:
    """The cells of a table of names and values as plain text."""
    names, values = (
        [cell if isinstance(cell, str) else str(cell) for cell in column.cells] for column in table.columns
    )
    return list(zip(names, values, strict=True))
