"""Results for people: pictures of clouds before and after, and tables for a terminal.

matplotlib is imported when the first picture is drawn.
"""

from torchreg.report.cloud_table import cloud_table
from torchreg.report.correspondence_figure import correspondence_figure
from torchreg.report.demo_table import DemoRow, demo_sentence, demo_table
from torchreg.report.figure import demo_figure, registration_figure
from torchreg.report.registration_table import matrix_text, registration_table
from torchreg.report.save import FIGURE_SUFFIXES, save_figure

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
]
