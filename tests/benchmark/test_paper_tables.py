"""Tables, charts and pictures from rows made by hand."""

import csv
import io

import pytest
from paper_rows import row

from torchreg.benchmark.core.study import Picture
from torchreg.benchmark.paper.charts import errors_chart, times_chart
from torchreg.benchmark.paper.differences_chart import differences_chart
from torchreg.benchmark.paper.document import csv_files, markdown, overview, tables
from torchreg.benchmark.paper.intervals import COMPARED
from torchreg.benchmark.paper.methods import METHODS
from torchreg.benchmark.paper.places import MALL, REAL, ROAD
from torchreg.benchmark.paper.printed import FPFH, FUSED
from torchreg.benchmark.paper.settings import SETTINGS, settings_of
from torchreg.benchmark.paper.summary import differences_of, errors_of, found_share, times_of
from torchreg.benchmark.paper.tables import added, added_in_words, as_printed, number, time_table
from torchreg.benchmark.paper.times import SPANS, TIMED
from torchreg.benchmark.paper.ways import AS_PAPER, MAIN_WAYS, OURS


def time_row(name, points):
    seconds = {f"{span}/{m}": [0.01, 0.02, 0.03] for span in SPANS for m in TIMED}
    seconds[f"{SPANS[0]}/{FUSED}"] = [0.011, 0.022, 0.033]
    return {"experiment": 4, "setting": name, "points": points, "seconds": seconds}


@pytest.fixture
def rows():
    """Three places a setting, whose errors are one, two and three times a number; only the first is found."""
    errors = [
        row(setting, group, place, method, way, rre=[8.0 * place], rte=[0.09 * place], rmse=[0.3 * place] * 3)
        for group in (MALL, REAL, ROAD)
        for setting in SETTINGS
        if setting.outdoor == group.outdoor
        for way in MAIN_WAYS
        for method in METHODS
        for place in (1, 2, 3)
    ]
    times = [time_row(s.name, s.points[0]) for s in settings_of(3)]
    return [*errors, *times]


def test_tables_have_the_papers_numbers_and_columns(rows):
    made = tables(rows)
    assert list(made) == [5, 6, 7, 8, 9]
    five = made[5][0]
    assert five.rows[0] == ["Initial pose", *"123" * 3]
    lines = {line[0]: line[1:] for line in five.rows}
    assert lines["RRE/°, paper"] == ["2.904", "4.084", "1.313", "0.824", "1.025", "0.635", "-", "-", "-"]
    assert lines["RTE/m, paper"][:6] == ["0.0638", "0.279", "0.099", "0.104", "0.091", "0.070"]
    assert lines["RRE/°, ours"] == ["16.0 ± 8.000"] * 9
    assert lines["RMSE/m, our median"] == ["0.600"] * 9
    assert lines["found"] == ["33% of 3"] * 9
    assert [table.heading[:8] for table in made[5]] == ["Table 5a", "Table 5b", "Table 5c", "Table 5d"]
    assert [table.heading for table in made[9]] == [
        f"Table 9a: {ROAD.title}; {OURS.title}",
        f"Table 9b: {ROAD.title}; {AS_PAPER.title}",
    ]
    assert len(made[6][0].head) == 4
    for several in made.values():
        for table in several:
            assert all(len(line) == len(table.head) for line in table.rows), table.heading


def test_table_7_stacks_the_methods_as_the_paper_does(rows):
    table = tables(rows)[7][0]
    assert table.head == ["Point count", "4k", "2k", "1k", "0.5k"]
    headings = [line[0] for line in table.rows if line[0].startswith("**")]
    assert headings[:2] == ["**FPFH-based algorithm**", "**Color-enhanced FPFH-based algorithm**"]
    printed = [line[1:] for line in table.rows if line[0] == "RRE/°, paper"]
    assert printed[0] == ["1.440", "39.795", "10.109", "29.795"]
    assert printed[1] == ["1.633", "2.108", "2.987", "21.990"]


def test_table_8_prints_the_slip_as_it_stands(rows):
    lines = {line[0]: line[1:] for line in time_table(times_of(rows)).rows}
    assert lines["FPFH, paper"] == ["0.0034 s", "0.0025 s", "0.0010 s", "0.0006 s"]
    assert lines["FPFH + PCFH, paper"][0] == "0.00036 s"
    assert lines[f"FPFH, {SPANS[0]}"][0] == "20 ms (10 to 30)"
    assert lines[f"added by PCFH, {SPANS[0]}"] == ["+10%"] * 4
    assert added(times_of(rows)[0], SPANS[1]) == 0
    assert "500 to 4,000 points: +10% to +10% (descriptors), +0% to +0%" in added_in_words(times_of(rows))


def test_a_run_of_one_experiment_has_its_table_alone(rows):
    names = (2, MALL.name, OURS.name)
    only = [one for one in rows if (one["experiment"], one.get("group"), one.get("way")) == names]
    made = tables(only)
    assert list(made) == [6]
    assert made[6][0].heading == f"Table 6: {MALL.title}; {OURS.title}"
    found, changes = overview(only)
    assert found.rows == [
        ["2: 12k / 4k", "the paper", "", "8.550", "0.200", "-"],
        ["", "3 x mall", OURS.name, *["33 [0, 100] %; 0.600 [0.300, 0.900]"] * 3],
    ]
    assert changes.rows == [["2: 12k / 4k", "3 x mall", OURS.name, *["0 undecided"] * 4]]


def test_markdown_says_what_kind_of_run_it_was(rows):
    whole = markdown(rows, [Picture(5, "a.png", "a picture")], "a processor")
    assert "quick" not in whole
    assert whole.index("## Table 9") < whole.index("![a picture](a.png)") < whole.index("## Overview")
    assert whole.endswith("a processor\n")
    assert "Real rooms" in whole
    simulated = [one for one in rows if one.get("group") == MALL.name]
    quick = markdown(simulated, [], "a processor", quick=True)
    assert "not comparable" in quick
    assert "Real rooms" not in quick


def test_csv_holds_every_number(rows):
    files = csv_files(rows)
    assert sorted(files) == ["intervals.csv", *(f"table{n}.csv" for n in (5, 6, 7, 8, 9))]
    lines = list(csv.DictReader(io.StringIO(files["table9.csv"])))
    assert len(lines) == len(METHODS) * 4 * len(MAIN_WAYS)
    first = lines[0]
    assert (first["group"], first["method"], first["measure"]) == ("road", FPFH, "rre_degrees")
    assert (float(first["paper"]), float(first["mean"]), float(first["most"])) == (0.281, 16.0, 24.0)
    assert (float(first["found"]), first["places"]) == (pytest.approx(1 / 3), "3")
    assert len(list(csv.DictReader(io.StringIO(files["table8.csv"])))) == 4 * len(SPANS) * len(TIMED) * 3


def test_one_place_has_no_deviation(rows):
    assert "±" not in markdown(rows[:1], [], "").split("## ")[1]


@pytest.mark.parametrize(("rmse", "threshold", "right"), [(0.49, 0.2, True), (0.51, 0.2, False), (0.2, 0.05, False)])
def test_found_is_measured_in_inlier_thresholds(rmse, threshold, right):
    assert found_share(row(SETTINGS[0], MALL, 0, FPFH, rmse=[rmse], threshold=threshold)) == right


def test_numbers_keep_the_papers_zeros():
    assert [as_printed(x, 3) for x in (2.1, 0.0638, 172.51)] == ["2.100", "0.0638", "172.510"]
    assert [number(x) for x in (0.1234, 9.9, 123.45)] == ["0.123", "9.900", "123.5"]


def test_charts_draw_every_dot_and_the_papers_numbers(rows):
    lines = [(group, OURS) for group in (MALL, REAL)]
    chart = errors_chart(3, lines, errors_of(rows))
    assert len(chart.axes) == 6
    for ax, real in zip(chart.axes, [False] * 3 + [True] * 3, strict=True):
        dots = sum(len(line.get_xdata()) for line in ax.lines if line.get_marker() == "o")
        diamonds = sum(line.get_marker() == "D" for line in ax.lines)
        assert dots == 4 * 3 * len(METHODS)
        assert diamonds == (0 if real else 4 * 2)
    assert len(times_chart(times_of(rows)).axes) == len(SPANS)


def test_the_chart_of_differences_has_a_bar_for_each(rows):
    chart = differences_chart([MALL, ROAD], MAIN_WAYS, differences_of(rows))
    assert len(chart.axes) == 2 * len(MAIN_WAYS)
    for ax in chart.axes:
        assert sum(line.get_marker() == "o" for line in ax.lines) == 9 * len(COMPARED)
    assert [label.get_text() for label in chart.axes[0].get_yticklabels()][-1] == "road, 5: road"
