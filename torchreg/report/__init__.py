"""Results for people: pictures of clouds before and after, and tables for a terminal.

matplotlib is imported when the first picture is drawn.
"""

from torchreg.report.canvas import FIGURE_SUFFIXES, save_figure
from torchreg.report.correspondences import correspondence_figure
from torchreg.report.demo import DemoRow, demo_sentence, demo_table
from torchreg.report.figures import demo_figure, registration_figure
from torchreg.report.tables import cloud_table, matrix_text, registration_table, summary_table, verification_table

__all__ = [
    "FIGURE_SUFFIXES",
    "DemoRow",
    "cloud_table",
    "correspondence_figure",
    "demo_figure",
    "demo_sentence",
    "demo_table",
    "matrix_text",
    "registration_figure",
    "registration_table",
    "save_figure",
    "summary_table",
    "verification_table",
]
