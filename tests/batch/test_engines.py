"""Whatever does the work, the table has the same bytes; what dies on the way is made good or named."""

import os
import signal
import sys
import threading
import time

import pytest
from projects import finish, lines_of, start

from torchreg.batch import Bounds, PairSettings, Store, pairs_of_file, run
from torchreg.batch.engine import Job
from torchreg.batch.local_engine import LocalEngine

BOUNDS = Bounds(15.0, None)
TABLES = ("results.csv", "results.json", "results.parquet")


def registered(project, out, engine):
    """Run the batch of a project in this process; returns what was done and the lines of the table."""
    pairs = pairs_of_file(project.table, PairSettings(effort="fast"))
    described = out.parent / f"{out.name}-described"
    described.mkdir()
    with Store(out, {}) as store:
        done = run(pairs, store, engine, described=described, bounds=BOUNDS)
        rows = store.finished()
    return done, [rows[pair.name].line for pair in pairs]


class _InMain(LocalEngine):
    """Loads in workers and computes in this process, as for a GPU."""

    def __init__(self, workers):
        super().__init__(workers)
        self._in_workers = False


@pytest.fixture(scope="module")
def expected(project, tmp_path_factory):
    return registered(project, tmp_path_factory.mktemp("expected") / "out", LocalEngine(0))[1]


@pytest.mark.parametrize("engine", [LocalEngine(1), LocalEngine(2), LocalEngine(3), _InMain(0), _InMain(2)])
def test_workers_and_where_they_compute_change_nothing(engine, project, expected, tmp_path):
    done, lines = registered(project, tmp_path / "out", engine)
    assert lines == expected
    assert (done.before, done.now, done.described, done.reused) == (0, 6, 4, 0)


def test_ray_gives_the_same_table(project, tmp_path):
    for engine in ("local", "ray"):
        ended = finish(start(project.table, "--out", tmp_path / engine, "--engine", engine, "--workers", 2))
        assert ended.code == 0, ended.stderr
    for name in TABLES:
        assert (tmp_path / "local" / name).read_bytes() == (tmp_path / "ray" / name).read_bytes(), name
    again = finish(start(project.table, "--out", tmp_path / "ray"))  # either engine goes on where the other ended
    assert "6 pairs were finished before" in again.stderr


def listening(process):
    """The addresses that a process and those below it listen at, asked until it ends."""
    import psutil

    found, family = set(), {process.pid}
    while process.poll() is None:
        try:
            family |= {child.pid for child in psutil.Process(process.pid).children(recursive=True)}
            known = psutil.net_connections(kind="inet")
        except psutil.Error:
            continue
        found |= {one.laddr.ip for one in known if one.pid in family and one.status == psutil.CONN_LISTEN}
        time.sleep(0.2)
    return found


@pytest.mark.parametrize(("told", "alone"), [({}, True), ({"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "1"}, False)])
def test_ray_listens_on_the_loopback_unless_told(project, tmp_path, told, alone):
    process = start(project.table, "--out", tmp_path / "out", "--engine", "ray", "--workers", 1, **told)
    addresses = listening(process)
    assert finish(process).code == 0
    assert addresses
    assert all(address.removeprefix("::ffff:").startswith("127.") for address in addresses) == alone, addresses


def children(parent, words):
    """Processes below ``parent`` whose command line holds ``words``."""
    import psutil

    found = []
    for process in psutil.Process(parent).children(recursive=True):
        try:
            line = " ".join(process.cmdline())
        except psutil.Error:
            continue
        if words in line:
            found.append(process)
    return found


def kill_a_worker(process, words, kills):
    """Kill busy workers of a batch, one after another, as long as it runs."""
    import psutil

    done = 0
    while process.poll() is None and done < kills:
        time.sleep(0.05)
        for worker in children(process.pid, words):
            try:
                if worker.cpu_percent(interval=0.1) > 30:
                    worker.send_signal(signal.SIGKILL)
                    done += 1
                    time.sleep(1.0)
                    break
            except psutil.Error:
                continue
    return done


@pytest.mark.skipif(sys.platform == "win32", reason="kills by a signal")
@pytest.mark.parametrize(
    ("engine", "words"),
    [pytest.param("ray", "ray::load_and_compute", marks=pytest.mark.slow), ("local", "forkserver")],
)
def test_a_worker_that_is_killed_leaves_the_table_as_it_is(engine, words, project, tmp_path):
    whole = finish(start(project.table, "--out", tmp_path / "whole"))
    assert whole.code == 0
    process = start(project.table, "--out", tmp_path / "broken", "--engine", engine, "--workers", 2)
    kills = []
    killer = threading.Thread(target=lambda: kills.append(kill_a_worker(process, words, 1)))
    killer.start()
    ended = finish(process)
    killer.join()
    assert ended.code == 0, ended.stdout + ended.stderr
    assert kills == [1]
    for name in TABLES:
        assert (tmp_path / "whole" / name).read_bytes() == (tmp_path / "broken" / name).read_bytes(), name


def _same(item):
    return item


def _die_at_three(item, loaded, device):
    if item == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return 10 * item


@pytest.mark.slow
def test_an_item_that_ends_every_process_fails_alone():
    outcomes = dict(LocalEngine(2).run(Job(_same, _die_at_three), list(range(6))))
    assert {place: outcome.value for place, outcome in outcomes.items() if place != 3} == {
        0: 0,
        1: 10,
        2: 20,
        4: 40,
        5: 50,
    }
    assert "ended unexpectedly" in outcomes[3].reason
    assert not outcomes[3].expected


def _fail_at_two(item, loaded, device):
    if item == 2:
        raise ValueError("item: expected another, got 2")
    return item


@pytest.mark.parametrize("engine", [LocalEngine(0), LocalEngine(2), _InMain(2)])
def test_an_error_in_one_item_is_its_outcome(engine):
    outcomes = dict(engine.run(Job(_same, _fail_at_two), list(range(4))))
    assert sorted(outcomes) == [0, 1, 2, 3]
    assert outcomes[2].reason == "item: expected another, got 2"
    assert [outcomes[k].value for k in (0, 1, 3)] == [0, 1, 3]
    assert list(engine.run(Job(_same, _fail_at_two), [])) == []


def test_a_table_names_every_pair_once(project, tmp_path):
    assert finish(start(project.table, "--out", tmp_path / "out")).code == 0
    names = [line["name"] for line in lines_of(tmp_path / "out")]
    assert len(set(names)) == len(names) == 6
