"""Results for people: pictures of clouds before and after, tables for a terminal, and pages on one pair.

matplotlib is imported when the first picture is drawn.
"""

from torchreg.report.canvas import FIGURE_SUFFIXES, save_figure
from torchreg.report.correspondences import correspondence_figure
from torchreg.report.demo import DemoRow, demo_sentence, demo_table
from torchreg.report.figures import demo_figure, registration_figure
from torchreg.report.page.report import REPORT_SUFFIXES, report_html, write_report
from torchreg.report.page.site_report import site_report_html, write_site_report
from torchreg.report.tables import cloud_table, matrix_text, registration_table, summary_table, verification_table
from torchreg.report.titles import picture_title

__all__ = [
    "FIGURE_SUFFIXES",
    "REPORT_SUFFIXES",
    "DemoRow",
    "cloud_table",
    "correspondence_figure",
    "demo_figure",
    "demo_sentence",
    "demo_table",
    "matrix_text",
    "picture_title",
    "registration_figure",
    "registration_table",
    "report_html",
    "save_figure",
    "site_report_html",
    "summary_table",
    "verification_table",
    "write_report",
    "write_site_report",
]
