"""A site on disk: resumed after any interruption, shared out, on any engine, it has the bits of an unbroken run."""

import random
import signal
import subprocess
import sys
from contextlib import closing
from dataclasses import replace

import pytest
import torch
from problems import room_site

import torchreg as tr
from torchreg.batch import LocalEngine
from torchreg.site.frame import SiteFrame
from torchreg.site.run import Shard, SiteSettings, run_shard, run_site
from torchreg.site.store import SiteStore

MANIFEST = {"seed": 0}


@pytest.fixture(scope="module")
def site():
    return room_site(4, points=1500)


@pytest.fixture(scope="module")
def paths(site, tmp_path_factory):
    folder = tmp_path_factory.mktemp("scans")
    for number, scan in enumerate(site.scans):
        tr.write_cloud(folder / f"{number}.npz", scan)
    return sorted(folder.iterdir())


@pytest.fixture(scope="module")
def whole(paths, tmp_path_factory):
    return begun(paths, tmp_path_factory.mktemp("runs") / "whole")


def begun(paths, out, *, workers=0, report=lambda _: None, manifest=MANIFEST, **more):
    with closing(LocalEngine(workers)) as engine, SiteStore(out, manifest) as store:
        (out / "described").mkdir(exist_ok=True)
        return run_site(paths, store, engine, described=out / "described", report=report, **more).result


def same(one, other):
    texts = [
        [repr(each.link.T_target_source.tolist()) + repr(each.link.log_odds) for each in result.links]
        for result in (one, other)
    ]
    names = ("T_world_scan", "group", "covariance", "center")
    alike = all(torch.equal(getattr(one, name), getattr(other, name)) for name in names)
    return alike and texts[0] == texts[1] and one.pairs == other.pairs


def test_it_has_the_bits_of_a_run_in_memory(site, paths, whole):
    assert whole.group.tolist() == [0, 0, 0, 0]
    assert same(whole, tr.register_site([tr.read_cloud(path) for path in paths]))


class StopError(Exception):
    """What ends a run."""


def test_stopped_at_any_step_and_resumed_it_has_the_same_bits(paths, whole, tmp_path):
    draw = random.Random(0)
    registered = []
    for _ in range(20):
        steps = draw.randint(1, 12)

        def stop(progress, left=[steps]):  # noqa: B006
            if progress.stage == "register":
                registered.append(progress.done)
            left[0] -= 1
            if left[0] == 0:
                raise StopError

        try:
            result = begun(paths, tmp_path / "out", report=stop)
        except StopError:
            continue
    result = begun(paths, tmp_path / "out")
    assert same(result, whole)
    assert len(registered) > 0


def test_finished_pairs_are_not_registered_again(paths, whole, tmp_path):
    begun(paths, tmp_path / "out")
    for path in (tmp_path / "out" / "described").iterdir():
        path.write_bytes(b"not a description")  # which registering would have to make again
    seen = []
    assert same(begun(paths, tmp_path / "out", report=seen.append, settings=SiteSettings()), whole)
    assert next(each for each in seen if each.stage == "register" and each.done).done == 6


@pytest.mark.parametrize("workers", [1, 2])
def test_workers_change_no_bit(paths, whole, tmp_path, workers):
    assert same(begun(paths, tmp_path / "out", workers=workers), whole)


def test_shards_do_each_pair_once_and_together_all(paths, whole, tmp_path):
    counts = []
    for number in (1, 2, 3):
        shard = Shard(number, 3)
        folder = shard.folder(tmp_path / "out")
        folder.parent.mkdir(parents=True, exist_ok=True)
        with closing(LocalEngine(0)) as engine, SiteStore(folder, MANIFEST) as store:
            described = tmp_path / "out" / "described"
            described.mkdir(exist_ok=True)
            counts.append(run_shard(paths, store, engine, shard, described=described))
    assert counts == [2, 2, 2]
    (tmp_path / "out" / "shards" / "job.log").write_text("what a job array wrote")
    registered = []
    assert same(begun(paths, tmp_path / "out", report=registered.append), whole)
    assert max(each.total for each in registered if each.stage == "describe") == 0  # nothing was left to register


def test_a_shard_of_other_settings_is_refused(paths, tmp_path):
    folder = Shard(1, 2).folder(tmp_path / "out")
    folder.parent.mkdir(parents=True)
    SiteStore(folder, {"seed": 1}).__exit__(None, None, None)
    with pytest.raises(ValueError, match="seed 1 there and 0 now"):
        begun(paths, tmp_path / "out")
    SiteStore(tmp_path / "out", {"seed": 1}).__exit__(None, None, None)  # the right settings are not locked out


def test_damaged_rows_are_made_again(paths, whole, tmp_path):
    import sqlite3

    begun(paths, tmp_path / "out")
    with sqlite3.connect(tmp_path / "out" / "site.sqlite") as database:
        database.execute("UPDATE pairs SET content = replace(content, '1', '2') WHERE rowid % 2 = 0")
        database.execute("UPDATE files SET checksum = 7 WHERE rowid = 1")
    assert same(begun(paths, tmp_path / "out"), whole)


def test_a_changed_file_is_looked_at_again(site, paths, tmp_path):
    copies = []
    for path in paths:
        copies.append(tmp_path / path.name)
        copies[-1].write_bytes(path.read_bytes())
    first = begun(copies, tmp_path / "out")
    tr.write_cloud(copies[1], replace(site.scans[1], points=site.scans[1].points + 0.25, viewpoint=None))
    second = begun(copies, tmp_path / "out")
    assert not torch.equal(first.T_world_scan[1], second.T_world_scan[1])
    assert torch.equal(first.T_world_scan[0], second.T_world_scan[0])


def test_a_scan_that_is_lost_on_the_way_is_left_out(paths, tmp_path):
    copies = [tmp_path / path.name for path in paths]
    for path, copy in zip(paths, copies, strict=True):
        copy.write_bytes(path.read_bytes())

    def lose(progress):
        if progress.stage == "look" and progress.done == progress.total:
            copies[3].unlink()

    result = begun(copies, tmp_path / "out", report=lose, frame=lambda _: SiteFrame(level=True))
    assert result.group.tolist() == [0, 0, 0, -1]
    assert all(copies[3].name in pair.reason for pair in result.pairs if 3 in pair[:2])


@pytest.mark.parametrize("text", ["0/4", "5/4", "2", "a/b", "1/0", "-1/4"])
def test_shards_are_checked(text):
    with pytest.raises(ValueError, match="--shard: expected K/N"):
        Shard.of_text(text, "--shard")
    assert Shard.of_text("2/8", "--shard") == (2, 8)


@pytest.mark.slow
def test_killed_twenty_times_and_resumed_the_files_have_the_same_bytes(paths, tmp_path):
    def start(out):
        words = ["-m", "torchreg", "site", *map(str, paths), "--out", str(out), "--workers", "1"]
        return subprocess.Popen([sys.executable, *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    assert start(tmp_path / "whole").wait() == 0
    draw, killed = random.Random(0), 0
    for _ in range(20):
        process = start(tmp_path / "broken")
        try:
            process.wait(draw.uniform(0.5, 4.5))
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            killed += 1
            process.wait()
    assert killed > 3
    assert start(tmp_path / "broken").wait() == 0
    for name in ("poses.csv", "site.json"):
        assert (tmp_path / "broken" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # Ray's own
def test_a_node_of_a_cluster_that_dies_changes_no_bit(paths, whole, tmp_path):
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    from torchreg.batch.ray_engine import RayEngine

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    node = cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()
    steps = []

    def report(progress):
        if progress.stage == "register":
            steps.append(progress.done)
            if len(steps) == 2:
                cluster.remove_node(node, allow_graceful=False)

    try:
        with closing(RayEngine(address=cluster.address)) as engine, SiteStore(tmp_path / "out", MANIFEST) as store:
            assert engine.workers == 2
            (tmp_path / "out" / "described").mkdir()
            result = run_site(paths, store, engine, described=tmp_path / "out" / "described", report=report).result
            assert engine.workers == 1
    finally:
        cluster.shutdown()
    assert len(steps) > 2
    assert same(result, whole)


def test_a_large_site_has_the_same_bits_in_memory_on_disk_and_by_shards(paths, tmp_path, monkeypatch):
    from torchreg.site import pairs, rounds

    monkeypatch.setattr(pairs, "FEW_SCANS", 2)
    monkeypatch.setattr(pairs, "ALL_SCANS", 3)
    monkeypatch.setattr(rounds, "ALL_SCANS", 3)
    monkeypatch.setattr(rounds, "_FIRST", 1)
    in_memory = tr.register_site([tr.read_cloud(path) for path in paths])
    assert in_memory.group.tolist() == [0, 0, 0, 0]
    assert 3 <= len(in_memory.pairs) < 6  # not all pairs, and as many as hold four scans
    seen = []
    assert same(begun(paths, tmp_path / "disk", report=seen.append), in_memory)
    assert any(each.stage == "compare" for each in seen)
    for number in (1, 2):
        shard = Shard(number, 2)
        shard.folder(tmp_path / "out").parent.mkdir(parents=True, exist_ok=True)
        with closing(LocalEngine(0)) as engine, SiteStore(shard.folder(tmp_path / "out"), MANIFEST) as store:
            (tmp_path / "out" / "described").mkdir(exist_ok=True)
            assert run_shard(paths, store, engine, shard, described=tmp_path / "out" / "described") > 0
    assert same(begun(paths, tmp_path / "out"), in_memory)
