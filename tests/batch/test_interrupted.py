"""A batch that is killed at any moment and started again ends with the table of an unbroken one."""

import json
import random
import signal
import sqlite3
import time
from pathlib import Path

import pytest
from projects import finish, lines_of, make_project, start

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="kills by signals")


def finished_pairs(out):
    """How many pairs are committed; 0 before there is a table."""
    try:
        with sqlite3.connect(f"file:{out}/batch.sqlite?mode=ro", uri=True) as database:
            return database.execute("SELECT COUNT(*) FROM pairs").fetchone()[0]
    except sqlite3.OperationalError:
        return 0


def kill_at_random(out, table, draw, most, *words):
    """Begin the batch and kill it soon after the start, or after some more pairs; returns whether it was at work."""
    process, before, begin = start(table, "--out", out, *words), finished_pairs(out), time.monotonic()
    early = draw.random() < 0.3
    moment, more = begin + draw.uniform(0.1, 6.0), draw.randint(0, most)
    while process.poll() is None:
        if (early and time.monotonic() >= moment) or (finished_pairs(out) >= before + more and out.exists()):
            break
        time.sleep(0.005)
    time.sleep(draw.uniform(0, 0.1))
    at_work = process.poll() is None
    process.send_signal(signal.SIGKILL)
    process.communicate()
    return at_work


def same_but_for_times(one, other):
    left, right = (json.loads(path.read_text()) for path in (one, other))
    left.pop("seconds"), right.pop("seconds")
    return left == right


def assert_equal_batches(broken, whole, pairs):
    assert len(lines_of(whole)) == pairs
    for name in ("results.csv", "results.json", "results.parquet"):
        assert (broken / name).read_bytes() == (whole / name).read_bytes(), name
    files = sorted(path.name for path in (whole / "pairs").iterdir())
    assert sorted(path.name for path in (broken / "pairs").glob("[!.]*")) == files
    assert all(same_but_for_times(broken / "pairs" / name, whole / "pairs" / name) for name in files)
    with sqlite3.connect(broken / "batch.sqlite") as database:  # no finished pair was ever computed again
        assert database.execute("SELECT MIN(runs), MAX(runs), COUNT(*) FROM pairs").fetchone() == (1, 1, pairs)


@pytest.mark.parametrize(
    ("clouds", "pairs", "kills", "words"),
    [
        (6, 15, 3, ("--workers", "1")),
        # slices of a few pairs, so that there is something to kill twenty times
        pytest.param(21, 200, 20, ("--max-bytes", "2000000"), marks=pytest.mark.slow),
    ],
)
def test_a_batch_killed_again_and_again_ends_as_an_unbroken_one(tmp_path, clouds, pairs, kills, words):
    project = make_project(tmp_path, clouds, 300, pairs)
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    assert finish(start(project.table, "--out", whole)).code == 0
    draw, at_work = random.Random(5), 0
    for _ in range(kills):
        at_work += kill_at_random(broken, project.table, draw, pairs // (2 * kills), *words)
    assert at_work == kills
    ended = finish(start(project.table, "--out", broken, *words))
    assert ended.code == 0, ended.stderr
    assert_equal_batches(broken, whole, pairs)


def test_an_interrupt_ends_a_batch_cleanly_and_the_same_command_resumes(tmp_path, project):
    out = tmp_path / "out"
    process = start(project.table, "--out", out, "--workers", 1)
    while finished_pairs(out) < 1 and process.poll() is None:
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    ended = finish(process)
    if ended.code != 0:  # it may have been done by then
        assert ended.code == 130
        assert "the same command resumes from there" in ended.stderr
        assert "Traceback" not in ended.stderr
    assert finish(start(project.table, "--out", out)).code == 0
    assert len(lines_of(out)) == 6


def shared_files(processes):
    """The semaphores and the shared memory that the processes have open, by their paths."""
    found = set()
    for process in processes:
        try:
            lines = Path("/proc", str(process.pid), "maps").read_text().splitlines()
        except OSError:
            continue
        found |= {line.split()[5] for line in lines if "/dev/shm/" in line}
    return found


@pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="looks for shared memory where Linux has it")
@pytest.mark.parametrize(
    ("ending", "engine"),
    [
        (signal.SIGTERM, "local"),
        (signal.SIGHUP, "local"),
        pytest.param(signal.SIGTERM, "ray", marks=pytest.mark.slow),
    ],
)
def test_a_signal_that_ends_a_batch_leaves_no_process_and_nothing_shared(tmp_path, ending, engine):
    import psutil

    project, out = make_project(tmp_path, clouds=10, points=1000), tmp_path / "out"
    before = signal.signal(ending, signal.SIG_DFL)  # under nohup it would be ignored, and so by the batch
    try:
        process = start(project.table, "--out", out, "--workers", 2, "--engine", engine)
    finally:
        signal.signal(ending, before)
    family = [psutil.Process(process.pid)]
    while finished_pairs(out) < 1 and process.poll() is None:
        time.sleep(0.01)
    family += family[0].children(recursive=True)
    shared = shared_files(family)
    assert len(family) > 3
    assert engine == "ray" or any("sem." in path for path in shared)
    process.send_signal(ending)
    ended = finish(process)
    assert ended.code == 128 + ending, ended.stderr
    assert "the same command resumes from there" in ended.stderr
    assert f"ended by {ending.name}" in ended.stderr
    assert "leaked" not in ended.stderr
    assert "Traceback" not in ended.stderr
    assert "received" not in ended.stderr
    _, alive = psutil.wait_procs(family, timeout=10)
    assert [one for one in alive if one.status() != psutil.STATUS_ZOMBIE] == []  # a zombie waits for its parent alone
    assert [path for path in shared if Path(path).exists()] == []
