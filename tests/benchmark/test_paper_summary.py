"""Sums over places and paired differences, on numbers made so that the answers are known."""

import csv
import io

import pytest
from paper_rows import row

from torchreg.benchmark.core.bootstrap import Interval
from torchreg.benchmark.paper.intervals import COMPARED, difference_table, intervals_csv, overview_table
from torchreg.benchmark.paper.methods import METHODS, PLAIN_HUE
from torchreg.benchmark.paper.places import MALL, ROAD
from torchreg.benchmark.paper.printed import FPFH, FUSED
from torchreg.benchmark.paper.settings import SETTINGS
from torchreg.benchmark.paper.summary import (
    LEAST_PLACES,
    Difference,
    Key,
    differences_of,
    found_share,
    spread_of,
    summarize,
)
from torchreg.benchmark.paper.ways import AS_PAPER, OURS, WAYS

SETTING = SETTINGS[0]


def key(method, way=OURS, group=MALL):
    return Key(SETTING.experiment, SETTING.name, group.name, way.name, method)


def paired_rows(changes, base=0.1):
    """Places that err by so many meters more with color than without, which itself differs far from place to place."""
    alone = [base + 0.02 * place for place in range(len(changes))]
    return [
        row(SETTING, MALL, place, method, rmse=[error + change * (method == FUSED)] * 3)
        for place, (error, change) in enumerate(zip(alone, changes, strict=True))
        for method in (FPFH, FUSED)
    ]


def test_a_gain_at_every_place_is_found_though_places_differ_more():
    rows = paired_rows([-0.01] * 12)
    change = differences_of(rows)[key(FUSED)]
    assert change.places == 12
    assert change.rmse == pytest.approx((-0.01, -0.01, -0.01))
    assert change.rmse_verdict == "better"
    cells = summarize(rows)
    assert cells[key(FPFH)].rmse.low < cells[key(FUSED)].rmse.value < cells[key(FPFH)].rmse.high  # unpaired: unseen
    assert differences_of(paired_rows([0.01] * 12))[key(FUSED)].rmse_verdict == "worse"
    assert differences_of(paired_rows([-0.01, 0.01] * 6))[key(FUSED)].rmse_verdict == "undecided"


def test_the_interval_is_that_of_places_not_of_runs():
    """Three runs that agree are no more places: the same interval as that of one run each."""
    changes = [-0.03, -0.02, 0.01, -0.05, 0.02, -0.01, -0.04, 0.03]
    thrice = paired_rows(changes)
    once = [one | {"rmse_meters": one["rmse_meters"][:1]} for one in thrice]
    assert differences_of(thrice) == differences_of(once)
    assert summarize(thrice)[key(FUSED)].rmse == summarize(once)[key(FUSED)].rmse


def test_the_interval_of_a_share_is_that_of_a_binomial():
    """Of 100 places 20 are found more with color: the bootstrap's interval is the normal one, 0.2 +- 1.96 x 0.04."""
    rows = [
        row(SETTING, MALL, place, method, rmse=[0.1 if method == FUSED and place < 20 else 9.0] * 3)
        for place in range(100)
        for method in (FPFH, FUSED)
    ]
    change = differences_of(rows)[key(FUSED)]
    assert change.found.value == pytest.approx(0.2)
    assert change.found[1:] == pytest.approx((0.1216, 0.2784), abs=0.012)
    assert change.found_verdict == "better"


def test_runs_count_within_a_place():
    one = row(SETTING, MALL, 0, FPFH, rmse=[0.1, 0.2, 9.0])
    assert found_share(one) == pytest.approx(2 / 3)
    cell = summarize([one])[key(FPFH)]
    assert cell.found.value == pytest.approx(2 / 3)
    assert cell.rmse == Interval(0.2, 0.2, 0.2)


def test_places_of_one_method_alone_are_not_compared():
    rows = paired_rows([-0.01] * 8)
    del rows[-2]  # FPFH of the last place, as in an unfinished run
    assert summarize(rows)[key(FUSED)].places == 8
    assert differences_of(rows)[key(FUSED)].places == 7
    assert differences_of([one for one in rows if one["method"] != FPFH]) == {}


def test_few_places_decide_nothing():
    for count, word in ((LEAST_PLACES - 1, "undecided"), (LEAST_PLACES, "better")):
        change = Difference(count, Interval(0.5, 0.4, 0.6), Interval(-0.5, -0.6, -0.4))
        assert (change.found_verdict, change.rmse_verdict) == (word, word)
    edge = Difference(60, Interval(0.5, 0.0, 0.6), Interval(-0.5, -0.6, 0.0))
    assert (edge.found_verdict, edge.rmse_verdict) == ("undecided", "undecided")


def test_cells_do_not_mix_groups_ways_or_methods():
    rows = [
        row(setting, group, place, method, way=way, rmse=[0.01 * place] * 3)
        for group in (MALL, ROAD)
        for setting in SETTINGS
        if setting.outdoor == group.outdoor
        for way in WAYS
        for method in METHODS
        for place in range(3)
    ]
    cells = summarize(reversed(rows))
    assert {cell.places for cell in cells.values()} == {3}
    assert len(cells) == 9 * len(WAYS) * len(METHODS)
    assert list(cells) == list(summarize(rows))
    assert len(differences_of(rows)) == 9 * len(WAYS) * len(COMPARED)


def test_spread_of_one_place_has_no_deviation():
    assert spread_of([2.0]) == (2.0, None, 2.0, 2.0, 2.0)
    assert spread_of([1.0, 3.0]).deviation == pytest.approx(2**0.5)


def test_tables_say_value_interval_and_verdict():
    rows = paired_rows([-0.01] * 12)
    rows += [one | {"way": AS_PAPER.name} for one in paired_rows([0.5] * 12)]
    shown = overview_table([MALL, ROAD], WAYS, summarize(rows))
    assert shown.rows[0] == ["1: pose 1", "the paper", "", "0.234", "0.127", "-"]
    assert [line[1:3] for line in shown.rows[1:]] == [["12 x mall", OURS.name], ["12 x mall", AS_PAPER.name]]
    assert shown.rows[1][3].startswith("100 %; 0.210 [0.1")
    assert shown.rows[1][5] == "-"
    changed = difference_table([MALL], WAYS, differences_of(rows))
    assert changed.rows[0] == ["1: pose 1", "12 x mall", OURS.name, "0 undecided", "-10 better", "-", "-"]
    assert changed.rows[1] == ["", "12 x mall", AS_PAPER.name, "-100 worse", "+500 worse", "-", "-"]
    for table in (shown, changed):
        assert all(len(line) == len(table.head) for line in table.rows)


def test_csv_of_intervals_holds_every_one():
    rows = paired_rows([-0.01] * 12)
    lines = list(csv.DictReader(io.StringIO(intervals_csv(summarize(rows), differences_of(rows)))))
    assert [line["quantity"] for line in lines].count("rmse_meters") == 2
    last = lines[-1]
    assert (last["method"], last["quantity"], last["count"]) == (FUSED, "rmse_meters_difference", "12")
    assert float(last["high"]) == pytest.approx(-0.01)
    assert last["verdict"] == "better"
    assert PLAIN_HUE not in {line["method"] for line in lines}
