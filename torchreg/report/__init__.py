"""Results for people: pictures of clouds before and after, and tables for a terminal.

matplotlib is imported when the first picture is drawn.
"""

from torchreg.report.cloud_table import cloud_table
from torchreg.report.demo_table import DemoRow, demo_sentence, demo_table
from torchreg.report.figure import demo_figure, registration_figure
from torchreg.report.registration_table import matrix_text, registration_table
from torchreg.report.save import FIGURE_SUFFIXES, save_figure
from torchreg.report.truth import TruthErrors, truth_errors

__all__ = [
    "FIGURE_SUFFIXES",
    "DemoRow",
    "TruthErrors",
    "cloud_table",
    "demo_figure",
    "demo_sentence",
    "demo_table",
    "matrix_text",
    "registration_figure",
    "registration_table",
    "save_figure",
    "truth_errors",
]
