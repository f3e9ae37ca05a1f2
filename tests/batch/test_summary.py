"""What a batch came to, from its lines."""

import pytest
from rich.console import Console

from torchreg.batch.rows import COLUMNS
from torchreg.batch.summary import summarize
from torchreg.report import summary_table


def line(name, state="registered", *, found=None, probability=None, **known):
    success = state == "registered"
    rest = {"success": success, "reason": "" if success else "why: not", "probability": probability, "found": found}
    return dict.fromkeys(COLUMNS) | {
        "name": name,
        "source": f"{name}.ply",
        "target": "t.ply",
        "state": state,
        **rest,
        **known,
    }


LINES = [
    line("sure", found=True, probability=0.99, rre_degrees=1.0, rte_meters=0.1),
    line("unsure", found=True, probability=0.61, rre_degrees=3.0, rte_meters=0.3),
    line("wrong", found=False, probability=0.9, rre_degrees=90.0, rte_meters=5.0),
    line("refused", "refused", found=False, probability=0.2),
    line("pity", "refused", found=True, probability=0.5, rre_degrees=1.0, rte_meters=0.1),
    line("unread", "unreadable"),
    line("broken", "error"),
    line("free", probability=0.7),
]


def test_counts_and_medians():
    found = summarize(LINES, [{"matching": 1.0}, {"matching": 0.5, "decision": 2.0}], {"describing clouds": 3.0})
    assert (found.pairs, found.clouds) == (8, 9)
    assert (found.registered, found.refused, found.unreadable, found.broken) == (4, 2, 1, 1)
    assert (found.with_truth, found.recalled, found.wrong_registered, found.right_refused) == (5, 2, 1, 1)
    assert found.recall == pytest.approx(0.4)
    assert (found.rre_degrees, found.rte_meters) == (2.0, 0.2)
    assert found.seconds == {"describing clouds": 3.0, "matching": 1.5, "decision": 2.0}


def test_the_worst_come_first():
    found = summarize(LINES, [], {})
    assert [name for name, _ in found.worst] == [
        *("wrong", "broken", "unread", "refused", "pity", "unsure", "free", "sure")
    ]
    said = dict(found.worst)
    assert said["wrong"] == "registered, but wrong by 90 degrees and 5 m"
    assert said["pity"] == "refused: why: not (its best pose is right)"
    assert said["free"] == "registered, probability 0.700"


def test_a_pose_that_is_wrong_beyond_measure_comes_first():
    lost = line("lost", found=False, probability=0.9)
    found = summarize([*LINES, lost], [], {})
    assert found.worst[0] == ("lost", "registered, but wrong beyond measure")


def test_a_batch_without_any_truth_or_time_says_nothing_of_them():
    found = summarize([line("one", fitness=0.4)], [], {})
    assert (found.recall, found.rre_degrees) == (None, None)
    console = Console(width=200)
    with console.capture() as capture:
        console.print(summary_table(found))
    assert "1 pair of 2 clouds" in capture.get()
    assert "recall" not in capture.get()
    assert "work" not in capture.get()
    assert "registered, fitness 0.400" in capture.get()
