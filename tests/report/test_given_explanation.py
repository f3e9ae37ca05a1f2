"""A given transform in words: what speaks for it, where it settles, and the advice that its failure asks for."""

import math

import pytest
import torch
from refusals import refuses
from results import failed_result, number, verification
from rich.console import Console

import torchreg as tr
from torchreg.report import matrix_text, verification_table
from torchreg.report.explain.given import deviation_text, rival_text
from torchreg.types.failure import KINDS_OF_GIVEN

NOWHERE = torch.full((1, 4, 4), math.nan, dtype=torch.float64)


def line(text, label):
    (found,) = [each for each in text.splitlines() if each.startswith(label)]
    return found


def refused(kind, **changes):
    failure = tr.Failure(kind, f"{kind}: by these figures")
    return verification(success=torch.tensor([False]), failure=(failure,), probability=number(0.0), **changes)


def unregistrable():
    """Clouds without a single pose."""
    search = failed_result("too few points", candidates=((),))
    return refused(
        "too few points",
        settled=NOWHERE,
        likeliest=NOWHERE,
        deviation_meters=number(math.nan),
        candidate=(None,),
        settled_candidate=(None,),
        rival=(None,),
        search=search,
    )


def test_a_right_one():
    text = verification().explain()
    assert line(text, "Verdict").endswith("right, probability 0.998 that the given transform is right")
    assert "0.1 m and 0.25 degrees away" in line(text, "Settles")
    assert "0.075 m are allowed" in line(text, "Settles")
    assert "nothing needs to change" in line(text, "May help")
    assert "47 % of the points have a partner within 0.075 m" in line(text, "Overlap")
    rows = [row.split()[0] for row in text.splitlines() if row.startswith("  ") and row[2:3].strip()]
    assert rows[:4] == ["pose", "as", "settled", "rival"]


@pytest.mark.parametrize(
    ("meters", "words"),
    [(0.0, "refinement finds nothing better"), (1e-9, "to a micrometer"), (0.0003, "0.30 mm and 0.25 degrees away")],
)
def test_how_far_off_is_told_in_the_unit_that_shows_it(meters, words):
    assert words in line(verification(deviation_meters=number(meters)).explain(), "Settles")


@pytest.mark.parametrize("kind", KINDS_OF_GIVEN)
def test_a_wrong_one_is_answered_by_the_pose_to_take(kind):
    text = refused(kind).explain()
    stated = "not right, probability 0.000 that the given transform is right"
    assert line(text, "Verdict").endswith(f"{stated}; {kind}: by these figures")
    assert "in its place" in line(text, "May help")


def test_where_the_search_is_in_doubt_too_its_advice_follows():
    search = failed_result("ambiguous")
    asked = refused("another pose is better", search=search).explain()
    assert "in its place" not in asked
    assert line(asked, "May help") == line(search.explain(), "May help")
    assert line(refused("ambiguous", search=search).explain(), "May help") == line(search.explain(), "May help")


def test_clouds_without_a_pose_have_no_figures_of_it():
    text = unregistrable().explain()
    for label in ("Settles", "Rival", "Evidence", "Overlap"):
        assert not any(each.startswith(label) for each in text.splitlines())
    assert line(text, "Verdict").endswith("too few points: by these figures")


def test_a_pair_that_there_is_not():
    with refuses("pair", "from 0 to 0"):
        verification().explain(1)


def test_where_it_settles_and_what_rivals_it():
    assert deviation_text(verification(deviation_meters=number(0.0)), 0).startswith("where it is")
    assert "turned by 90 degrees; probability 0.001" in rival_text(verification(), 0)
    assert rival_text(verification(rival=(None,)), 0).startswith("none")


def shown(result):
    console = Console(width=200, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(verification_table(result, source="[a].ply", target="b.ply", given="T.txt", file_notes=["gray"]))
    console.file.close()
    return console.export_text()


def collapsed(text):
    return " ".join(text.split())


def test_the_table_says_what_explain_says_and_shows_the_pose_to_take():
    right, wrong = shown(verification()), shown(refused("another pose is better"))
    for text in (right, wrong):
        for words in ("[a].ply", "b.ply", "T.txt", "0.5500 of the source points", "0.1 m and 0.25 degrees", "gray"):
            assert words in text
    assert right.rstrip().endswith("right")
    assert "not right" not in right
    assert wrong.rstrip().endswith("not right: another pose is better: by these figures")
    first = collapsed(matrix_text(verification().settled[0]).splitlines()[0])
    assert [label for label in ("settled", "better") if f"{label} {first}" in collapsed(right)] == ["settled"]
    assert [label for label in ("settled", "better") if f"{label} {first}" in collapsed(wrong)] == ["better"]
    assert first not in collapsed(shown(refused("ambiguous", search=failed_result("ambiguous"))))


def test_the_table_of_clouds_without_a_pose():
    text = shown(unregistrable())
    assert "settles" not in text
    assert "fitness" not in text
