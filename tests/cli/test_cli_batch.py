"""``torchreg batch``: tables, resuming, what it refuses, and what it says."""

import errno
import json
import os
import shutil
import sqlite3
from pathlib import Path

import pyarrow.parquet
import pytest
import torch
from filelock import FileLock
from problems import room_pair
from projects import lines_of, make_project, write_table

import torchreg as tr
from torchreg.batch import runner as runner_module
from torchreg.batch import store as store_module
from torchreg.io import read_transform_text
from torchreg.io.result_json import plain_data


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """Three small clouds of one room each, three pairs."""
    return make_project(tmp_path_factory.mktemp("project"), clouds=3, points=400)


@pytest.fixture
def batch(run, tmp_path):
    """Run ``torchreg batch`` in this process, into ``tmp_path / "out"`` unless told otherwise."""

    def command(*words, out="out"):
        return run("batch", *words, "--out", tmp_path / out, "--workers", "0")

    return command


def rows_of_database(folder, columns="name, state, runs"):
    with sqlite3.connect(folder / "batch.sqlite") as database:
        return database.execute(f"SELECT {columns} FROM pairs ORDER BY name").fetchall()


def room_table(room, folder, **columns):
    return write_table(folder / "room.csv", [{"source": room.source, "target": room.target, **columns}])


def test_a_table_of_pairs_with_a_truth_is_registered_and_summarized(batch, room, tmp_path):
    other = make_project(tmp_path, clouds=1, points=500)
    truth = " ".join(map(repr, read_transform_text(room.truth).flatten().tolist()))
    rows = [
        {"name": "right", "source": room.source, "target": room.target, "truth": room.truth, "floor": "2"},
        {"name": "swapped", "source": room.target, "target": room.source, "truth": truth},  # a wrong truth
        {"name": "strangers", "source": room.source, "target": other.folder / "c0.ply"},
    ]
    result = batch(write_table(tmp_path / "pairs.csv", rows))
    assert result.exit_code == 0, result.output
    out = tmp_path / "out"
    right, swapped, strangers = lines_of(out)
    assert (right["success"], right["state"], right["found"], right["floor"]) == ("true", "registered", "true", "2")
    assert float(right["rre_degrees"]) < 2
    assert (swapped["success"], swapped["found"]) == ("true", "false")
    assert right["failure"] == ""
    assert strangers["found"] == ""
    T = torch.tensor([float(number) for number in right["T_target_source"].split()], dtype=torch.float64)
    record = json.loads((out / "pairs" / "right.json").read_text())
    assert torch.equal(T.view(4, 4), torch.tensor(record["T_target_source"], dtype=torch.float64))
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["pairs"], summary["with_truth"], summary["recalled"], summary["wrong_registered"]) == (3, 2, 1, 1)
    assert summary["worst"][0][0] == "swapped"
    assert "1 of 2 (50 %)" in result.stdout
    assert set(summary["seconds"]) >= {"measuring clouds", "describing clouds", "matching", "hypotheses", "decision"}


def test_a_list_of_pairs_is_registered_as_a_table_is(batch, room, tmp_path):
    truth = read_transform_text(room.truth)
    entry = {"name": "right", "source": str(room.source), "target": str(room.target), "effort": "fast", "voxel_m": 1}
    (tmp_path / "pairs.json").write_text(json.dumps({"pairs": [entry | {"T": truth.tolist(), "truth": "computed"}]}))
    assert batch(tmp_path / "pairs.json").exit_code == 0
    (line,) = lines_of(tmp_path / "out")
    assert (line["name"], line["found"], line["effort"], line["voxel_m"]) == ("right", "true", "fast", "1")


@pytest.mark.parametrize("points", [(), ("--points", "300")])
def test_seeds_have_one_rule_with_points_and_without(batch, project, tmp_path, points):
    """Any whole number; of anything else the option or the column is named and no cloud is blamed."""
    pair = {"source": project.folder / "c0.ply", "target": project.folder / "c1.ply", "effort": "fast"}
    table = write_table(tmp_path / "pairs.csv", [pair])
    for seed in (2**63, 10**30, -1):
        assert batch(table, *points, "--seed", str(seed), out=f"out{seed}").exit_code == 0
    for seed in (1.5, "one"):
        refused = batch(table, *points, "--seed", str(seed), out="no")
        assert refused.exit_code == 2
        assert "--seed" in refused.stderr
        refused = batch(write_table(tmp_path / "seeds.csv", [{**pair, "seed": seed}]), *points, out="no")
        assert refused.exit_code == 2
        assert "line 2, column seed: expected a whole number" in refused.stderr.replace("\n", "")
    assert not (tmp_path / "no").exists()


def test_a_row_has_the_kind_of_its_failure(batch, room, tmp_path):
    tr.write_cloud(tmp_path / "line.ply", tr.Clouds(torch.linspace(0, 5, 200)[:, None] * torch.tensor([1.0, 2.0, 0.5])))
    assert batch(write_table(tmp_path / "p.csv", [{"source": "line.ply", "target": room.target}])).exit_code == 0
    (line,) = lines_of(tmp_path / "out")
    (file,) = (tmp_path / "out" / "pairs").iterdir()
    record = json.loads(file.read_text())
    assert (line["state"], line["failure"]) == ("refused", "degenerate")
    assert (record["failure"]["kind"], record["reason"]) == ("degenerate", line["reason"])
    for name in ("T_target_source", "likeliest_T_target_source"):
        assert (record[name], line[name]) == (None, "")


def test_the_likeliest_pose_of_a_refused_pair_is_kept_apart(batch, room, tmp_path):
    tr.write_cloud(tmp_path / "other.ply", room_pair(3000, seed=5, scale=0.8).source)
    table = write_table(tmp_path / "p.csv", [{"source": "other.ply", "target": room.target}])
    assert batch(table).exit_code == 0
    (line,) = lines_of(tmp_path / "out")
    assert (line["state"], line["T_target_source"]) == ("refused", "")
    (file,) = (tmp_path / "out" / "pairs").iterdir()
    record = json.loads(file.read_text())
    likeliest = torch.tensor(record["likeliest_T_target_source"], dtype=torch.float64)
    numbers = [float(number) for number in line["likeliest_T_target_source"].split()]
    assert numbers == likeliest.flatten().tolist()
    assert record["T_target_source"] is None
    assert likeliest.tolist() == record["candidates"][0]["T_target_source"]


def test_the_tables_agree(batch, project, tmp_path):
    assert batch(project.table).exit_code == 0
    out = tmp_path / "out"
    parquet = pyarrow.parquet.read_table(out / "results.parquet").to_pylist()
    assert parquet == json.loads((out / "results.json").read_text())
    for line, cells in zip(parquet, lines_of(out), strict=True):
        assert list(line) == list(cells)
        assert cells["name"] == line["name"]
        assert cells["probability"] == ("" if line["probability"] is None else repr(line["probability"]))
    times = (out / "times.csv").read_text().splitlines()
    assert len(times) == 4
    assert times[0].startswith("name,matching,hypotheses,rivals,decision,second look")


def test_a_pair_alone_has_the_lengths_and_the_result_of_register(batch, room, tmp_path):
    assert batch(room_table(room, tmp_path)).exit_code == 0
    (line,) = lines_of(tmp_path / "out")
    result = tr.register(tr.read_cloud(room.source), tr.read_cloud(room.target))
    assert [float(number) for number in line["T_target_source"].split()] == result.T_target_source.flatten().tolist()
    assert float(line["inlier_threshold"]) == result.options[0].ransac.inlier_threshold


@pytest.mark.parametrize("words", [(), ("--scale", "pair")])
@pytest.mark.parametrize("sizes", [(900, 1000), (300, 3000), (40_000, 15_000)])
def test_the_lengths_of_a_pair_alone_are_those_that_register_derives(batch, tmp_path, sizes, words):
    clouds = [room_pair(size, seed=k).source for k, size in enumerate(sizes)]
    for name, cloud in zip("ab", clouds, strict=True):
        tr.write_cloud(tmp_path / f"{name}.ply", cloud)
    table = write_table(tmp_path / "pairs.csv", [{"source": "a.ply", "target": "b.ply", "effort": "fast"}])
    assert batch(table, *words).exit_code == 0
    record = json.loads((tmp_path / "out" / "pairs" / "a__b.json").read_text())
    read = [tr.read_cloud(tmp_path / f"{name}.ply") for name in "ab"]
    alone = tr.register(*read, effort="fast")
    assert record["options"] == plain_data(alone.options[0])
    pose = "T_target_source" if bool(alone.success[0]) else "likeliest_T_target_source"
    assert record[pose] == alone.T_target_source[0].tolist()


def test_every_pair_has_its_own_lengths_where_that_is_asked_for(batch, project, tmp_path):
    assert batch(project.table, "--scale", "pair").exit_code == 0
    for line in lines_of(tmp_path / "out"):
        read = [tr.read_cloud(project.folder / line[side]) for side in ("source", "target")]
        assert float(line["inlier_threshold"]) == tr.derive_options(*read)[0].ransac.inlier_threshold


def test_a_moved_copy_of_a_cloud_does_not_share_its_choice_of_points(batch, room, tmp_path):
    cloud = tr.read_cloud(room.source)
    turned = tr.transform(cloud, read_transform_text(room.truth))
    tr.write_cloud(tmp_path / "copy.ply", turned)
    table = write_table(tmp_path / "pairs.csv", [{"source": room.source, "target": "copy.ply", "points": 500}])
    assert batch(table).exit_code == 0
    (line,) = lines_of(tmp_path / "out")
    assert (line["points_source"], line["points_target"]) == ("500", "500")
    assert float(line["inlier_rmse"]) > 1e-3  # all points shared would lie on each other


def test_a_pair_that_failed_may_be_corrected(batch, project, tmp_path):
    rows = [{"name": "x", "source": project.folder / "c0.ply", "target": "typo.ply"}]
    table = write_table(tmp_path / "pairs.csv", rows)
    assert batch(table).exit_code == 3
    rows[0]["target"] = project.folder / "c1.ply"
    write_table(tmp_path / "pairs.csv", rows)
    assert batch(table).exit_code == 0
    assert lines_of(tmp_path / "out")[0]["state"] in ("registered", "refused")


def test_recall_counts_the_pairs_that_could_not_be_read(batch, room, tmp_path):
    rows = [{"name": "x", "source": "missing.ply", "target": room.target, "truth": room.truth}]
    assert batch(write_table(tmp_path / "pairs.csv", rows)).exit_code == 3
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary["with_truth"], summary["recalled"], summary["recall"]) == (1, 0, 0.0)


def test_a_cloud_that_spoils_a_slice_fails_its_own_pairs_alone(batch, project, tmp_path, monkeypatch):
    from torchreg.batch import jobs
    from torchreg.batch.engine import Job

    whole = jobs._register
    calls = []

    def spoiled(item, loaded, device):
        calls.append(len(item))
        if any("c2" in pair.pair.name for pair in item):
            raise RuntimeError("spoiled")
        return whole(item, loaded, device)

    monkeypatch.setattr(runner_module, "REGISTER", Job(jobs._load_slice, spoiled))
    monkeypatch.setattr("torchreg.batch.plan._ROUNDS", 1)
    assert batch(project.table).exit_code == 3
    assert calls == [3, 1, 1, 1]
    states = {line["name"]: line["state"] for line in lines_of(tmp_path / "out")}
    assert states["c0__c2"] == states["c1__c2"] == "error"
    assert states["c0__c1"] in ("registered", "refused")


def test_files_of_pairs_that_are_lost_or_damaged_are_written_again(batch, project, tmp_path):
    assert batch(project.table).exit_code == 0
    files = sorted((tmp_path / "out" / "pairs").iterdir())
    before = [file.read_bytes() for file in files]
    files[0].unlink()
    files[1].write_text("junk")
    again = batch(project.table)
    assert "3 pairs were finished before" in again.stderr
    assert [file.read_bytes() for file in files] == before


def test_a_cloud_of_finished_pairs_may_be_gone(batch, project, tmp_path):
    (tmp_path / "a.ply").write_bytes((project.folder / "c0.ply").read_bytes())
    table = write_table(tmp_path / "pairs.csv", [{"source": "a.ply", "target": project.folder / "c1.ply"}])
    assert batch(table).exit_code == 0
    before = (tmp_path / "out" / "results.csv").read_bytes()
    (tmp_path / "a.ply").unlink()
    again = batch(table)
    assert again.exit_code == 0
    assert "no such file" not in again.stderr
    assert (tmp_path / "out" / "results.csv").read_bytes() == before


def test_a_truth_beyond_all_bounds_is_no_error(batch, room, tmp_path):
    assert batch(room_table(room, tmp_path, truth="1 0 0 1e308 0 1 0 0 0 0 1 0 0 0 0 1")).exit_code == 0
    assert lines_of(tmp_path / "out")[0]["found"] == "false"


def test_a_pattern_takes_clouds_alone(batch, project, tmp_path):
    assert batch("--all-pairs", project.folder / "*").exit_code == 0  # beside a table
    assert len(lines_of(tmp_path / "out")) == 3
    for name in ("one.md", "other.md", "a.txt", "b.csv"):
        (tmp_path / name).write_text("no cloud")
    for pattern in ("*.md", "*", "*.txt"):
        refused = batch("--all-pairs", tmp_path / pattern)
        assert refused.exit_code == 2
        assert "at least two clouds" in refused.stderr


def test_a_cluster_that_does_not_answer_is_said_soon_and_leaves_no_folder(run, project, tmp_path):
    refused = run("batch", project.table, "--out", tmp_path / "out", "--engine", "ray", "--ray-address", "127.0.0.1:1")
    assert refused.exit_code == 2
    assert "127.0.0.1:1" in refused.stderr
    both = run(
        "batch", project.table, "--out", tmp_path / "out", "--engine", "ray", "--ray-address", "auto", "--workers", "2"
    )
    assert "workers" in both.stderr
    assert not (tmp_path / "out").exists()


def test_a_damaged_database_is_named(batch, project, tmp_path):
    assert batch(project.table).exit_code == 0
    (tmp_path / "out" / "batch.sqlite").write_bytes(b"no database" * 1000)
    refused = batch(project.table)
    assert refused.exit_code == 2
    assert "batch.sqlite" in refused.stderr


def test_all_pairs_of_names_that_could_be_confused_have_names_of_their_own(batch, project, tmp_path):
    for name in ("a", "b__c", "a__b", "c"):
        (tmp_path / f"{name}.ply").write_bytes((project.folder / "c0.ply").read_bytes())
    assert batch("--all-pairs", tmp_path / "*.ply", "--effort", "fast").exit_code == 0
    assert len({line["name"] for line in lines_of(tmp_path / "out")}) == 6
    assert len(list((tmp_path / "out" / "pairs").iterdir())) == 6


def test_columns_named_like_those_of_the_table_are_kept_beside_them(batch, room, tmp_path):
    table = room_table(room, tmp_path, state="Bavaria", pair_state="Hesse", overlap="0.5")
    assert batch(table).exit_code == 0
    (line,) = lines_of(tmp_path / "out")
    assert (line["state"], line["pair_overlap"]) == ("registered", "0.5")
    assert {line["pair_state"], line["pair_pair_state"]} == {"Bavaria", "Hesse"}


def test_columns_change_the_options_of_their_pair(batch, room, tmp_path):
    rows = [
        {"name": "a", "voxel": 0.2, "effort": "fast"},
        {"name": "b", "inlier_threshold": 0.3, "seed": 4, "no_color": "true"},
        {"name": "c", "preset": "paper", "hypotheses": 500, "points": 900},
    ]
    ends = [(room.source, room.target), (room.target, room.source), (room.target, room.target)]
    rows = [{"source": one, "target": other, **row} for row, (one, other) in zip(rows, ends, strict=True)]
    assert batch(write_table(tmp_path / "pairs.csv", rows)).exit_code == 0
    records = [json.loads((tmp_path / "out" / "pairs" / f"{name}.json").read_text()) for name in "abc"]
    options = [record["options"] for record in records]
    assert options[0]["voxel_size"] == 0.2
    assert options[0]["normal_radius"] > 2.5 * 0.2  # fast is 1.5 times as coarse, where nothing is given
    assert options[0]["effort"] == "fast"
    assert options[1]["solver"]["inlier_threshold"] == 0.3
    assert [record["name"] for record in options[1]["descriptors"]] == ["fpfh"]
    assert (options[2]["descriptors"][0]["radius"], options[2]["solver"]["hypotheses"]) == (5.0, 500)
    assert records[1]["seed"] == 4
    assert records[2]["stages"]["given"] == {"source": 900, "target": 900}


def test_all_pairs_of_a_pattern_describe_every_cloud_once(batch, project, tmp_path):
    result = batch("--all-pairs", project.folder / "c*.ply")
    assert result.exit_code == 0, result.output
    assert [line["name"] for line in lines_of(tmp_path / "out")] == ["c0__c1", "c0__c2", "c1__c2"]
    assert len(list((tmp_path / "out" / "described").iterdir())) == 3


def test_both_directions_of_all_pairs_describe_every_cloud_once(batch, project, tmp_path):
    ends = [(i, k) for i in range(3) for k in range(3) if i != k]
    table = write_table(tmp_path / "both.csv", [
        {"source": project.folder / f"c{i}.ply", "target": project.folder / f"c{k}.ply"} for i, k in ends
    ])  # fmt: skip
    assert batch(table).exit_code == 0
    assert len(list((tmp_path / "out" / "described").iterdir())) == 3
    assert batch(table, "--cache", tmp_path / "out" / "described", out="again").exit_code == 0  # nothing is described
    assert len(list((tmp_path / "out" / "described").iterdir())) == 3
    assert not (tmp_path / "again" / "described").exists()
    assert (tmp_path / "again" / "results.csv").read_bytes() == (tmp_path / "out" / "results.csv").read_bytes()


def test_equal_clouds_of_other_names_are_described_once(batch, project, tmp_path):
    for name in ("copy.ply", "first.ply"):
        (tmp_path / name).write_bytes((project.folder / "c0.ply").read_bytes())
    rows = [{"source": name, "target": project.folder / "c1.ply"} for name in ("copy.ply", "first.ply")]
    assert batch(write_table(tmp_path / "pairs.csv", rows)).exit_code == 0
    assert len(list((tmp_path / "out" / "described").iterdir())) == 2


def test_a_finished_batch_is_not_computed_again(batch, project, tmp_path, monkeypatch):
    assert batch(project.table).exit_code == 0
    before = (tmp_path / "out" / "results.csv").read_bytes()
    monkeypatch.setattr("torchreg.batch.clouds.read_cloud_report", None)
    monkeypatch.setattr("torchreg.batch.jobs.register_described", None)
    again = batch(project.table)
    assert again.exit_code == 0, again.output
    assert "3 pairs were finished before" in again.stderr
    assert (tmp_path / "out" / "results.csv").read_bytes() == before


def test_pairs_that_are_added_are_registered_and_the_others_stand(batch, project, tmp_path):
    rows = [
        {"source": project.folder / f"c{i}.ply", "target": project.folder / f"c{k}.ply"} for i, k in ((0, 1), (1, 2))
    ]
    table = tmp_path / "pairs.csv"
    assert batch(write_table(table, rows[:1])).exit_code == 0
    first = lines_of(tmp_path / "out")[0]
    assert batch(write_table(table, rows)).exit_code == 0
    assert lines_of(tmp_path / "out")[0] == first
    assert [runs for _, _, runs in rows_of_database(tmp_path / "out")] == [1, 1]


def test_other_options_are_refused_by_name_and_what_is_finished_stands(batch, project, tmp_path):
    assert batch(project.table).exit_code == 0
    before = (tmp_path / "out" / "results.csv").read_bytes()
    for words, named in [
        (("--effort", "fast"), "effort not given there and fast now"),
        (("--voxel", "0.1"), "voxel not given there and 0.1 now"),
        (("--seed", "3"), "seed 0 there and 3 now"),
        (("--recall-degrees", "5"), "recall"),
    ]:
        refused = batch(project.table, *words)
        assert refused.exit_code == 2
        assert named in refused.stderr
        assert (tmp_path / "out" / "results.csv").read_bytes() == before


def test_a_finished_pair_of_another_truth_is_refused(batch, project, room, tmp_path):
    rows = [{"source": project.folder / "c0.ply", "target": project.folder / "c1.ply", "name": "x"}]
    assert batch(write_table(tmp_path / "pairs.csv", rows)).exit_code == 0
    rows[0]["truth"] = room.truth
    refused = batch(write_table(tmp_path / "pairs.csv", rows))
    assert refused.exit_code == 2
    assert "pair x" in refused.stderr
    assert "truth" in refused.stderr


def test_a_cloud_that_changed_is_registered_again(batch, project, tmp_path):
    for name in ("a.ply", "b.ply"):
        (tmp_path / name).write_bytes((project.folder / "c0.ply").read_bytes())
    table = write_table(tmp_path / "pairs.csv", [{"source": "a.ply", "target": "b.ply"}])
    assert batch(table).exit_code == 0
    (tmp_path / "a.ply").write_bytes((project.folder / "c1.ply").read_bytes())
    again = batch(table)
    assert "1 finished pairs have other clouds or lengths now" in again.stderr
    assert rows_of_database(tmp_path / "out", "runs") == [(2,)]


def test_files_that_are_missing_or_damaged_fail_their_pairs_alone_and_are_tried_again(batch, project, tmp_path):
    good = project.folder / "c0.ply"
    (tmp_path / "damaged.ply").write_bytes(good.read_bytes()[:3000])
    rows = [
        {"source": "missing.ply", "target": good},
        {"source": good, "target": project.folder / "c1.ply"},
        {"source": good, "target": "damaged.ply"},
    ]
    table = write_table(tmp_path / "pairs.csv", rows)
    result = batch(table)
    assert result.exit_code == 3
    assert "missing.ply: no such file" in result.stderr
    states = [line["state"] for line in lines_of(tmp_path / "out")]
    assert states[0] == states[2] == "unreadable"
    assert states[1] in ("registered", "refused")
    assert "missing.ply" in lines_of(tmp_path / "out")[0]["reason"]
    assert "damaged.ply" in lines_of(tmp_path / "out")[2]["reason"]
    for name in ("missing.ply", "damaged.ply"):
        (tmp_path / name).write_bytes((project.folder / "c2.ply").read_bytes())
    assert batch(table).exit_code == 0
    assert rows_of_database(tmp_path / "out", "runs") == [(1,), (2,), (2,)]


def test_a_description_that_is_damaged_is_made_again(batch, project, tmp_path):
    assert batch(project.table).exit_code == 0
    for file in (tmp_path / "out" / "described").iterdir():
        file.write_bytes(file.read_bytes()[:1000])
    again = batch(project.table, "--cache", tmp_path / "out" / "described", out="again")
    assert again.exit_code == 0
    assert (tmp_path / "again" / "results.csv").read_bytes() == (tmp_path / "out" / "results.csv").read_bytes()


def test_a_full_disk_ends_the_run_and_what_is_finished_stands(batch, project, tmp_path, monkeypatch):
    write, left = store_module.write_text, [2]

    def writes_until_full(path, text, **how):
        if "pairs" in Path(path).parts[-2]:
            left[0] -= 1
            if left[0] < 0:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        return write(path, text, **how)

    monkeypatch.setattr(store_module, "write_text", writes_until_full)
    stopped = batch(project.table)
    assert stopped.exit_code == 2
    assert "No space left" in stopped.stderr
    assert len(rows_of_database(tmp_path / "out")) == 2
    monkeypatch.setattr(store_module, "write_text", write)
    assert batch(project.table).exit_code == 0
    assert rows_of_database(tmp_path / "out", "runs") == [(1,), (1,), (1,)]


def test_a_disk_that_is_full_for_descriptions_ends_the_run(batch, project, tmp_path, monkeypatch):
    def full(path, described):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    monkeypatch.setattr("torchreg.batch.jobs.write_described", full)
    stopped = batch(project.table)
    assert stopped.exit_code == 2
    assert "the same command resumes from there" in stopped.stderr
    assert rows_of_database(tmp_path / "out") == []


def test_a_folder_of_descriptions_that_is_removed_ends_the_run_and_blames_no_cloud(
    batch, project, tmp_path, monkeypatch
):
    from torchreg.batch import described_file

    def removed(path, described):
        shutil.rmtree(path.parent, ignore_errors=True)
        described_file.write_described(path, described)

    monkeypatch.setattr("torchreg.batch.jobs.write_described", removed)
    stopped = batch(project.table)
    assert stopped.exit_code == 2
    assert "described" in stopped.stderr
    assert "the same command resumes from there" in stopped.stderr
    assert rows_of_database(tmp_path / "out") == []
    monkeypatch.undo()
    assert batch(project.table).exit_code == 0


@pytest.mark.parametrize("content", [b"", b"[]", b"null", b"\xff", b"[" * 100_000, b'{"torchreg": "0.0"}'])
def test_options_of_a_run_that_nobody_can_read_or_of_another_version_are_refused(batch, project, tmp_path, content):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "run.json").write_bytes(content)
    refused = batch(project.table)
    assert refused.exit_code == 2
    assert "run.json" in refused.stderr or "torchreg 0.0 there" in refused.stderr
    assert sorted(path.name for path in (tmp_path / "out").glob("[!.]*")) == ["run.json"]


def test_a_folder_in_use_is_refused(batch, project, tmp_path):
    (tmp_path / "out").mkdir()
    with FileLock(tmp_path / "out" / ".lock"):
        refused = batch(project.table)
    assert refused.exit_code == 2
    assert "without a run at work" in refused.stderr


@pytest.mark.parametrize(
    ("table", "named"),
    [
        ("source,goal\na.ply,b.ply\n", "target"),
        ("source,target\na.ply,b.ply\nc.ply,d.ply\na.ply,b.ply\n", "line 2"),
        ("source,target,voxel\na.ply,b.ply,wide\n", "column voxel"),
        ("source,target,voxle\na.ply,b.ply,1\n", "voxle"),
        ("source,target,effort\na.ply,b.ply,huge\n", "effort"),
        ("source,target,inlier_threshold\na.ply,b.ply,-1\n", "inlier_threshold"),
        ("source,target,hypotheses\na.ply,b.ply,900\n", "line 2: hypotheses: expected the solver ransac"),
        ("source,target,truth\na.ply,b.ply,1 2 3\n", "truth"),
        ("source,target\n", "at least one pair"),
        ("", "empty"),
    ],
)
def test_a_table_that_means_nothing_is_refused_before_any_work(batch, tmp_path, table, named):
    (tmp_path / "pairs.csv").write_text(table)
    refused = batch(tmp_path / "pairs.csv")
    assert refused.exit_code == 2
    assert named in refused.stderr
    assert not (tmp_path / "out").exists()


def test_what_does_not_fit_together_is_refused(batch, run, project, tmp_path):
    for words, named in [
        ((), "PAIRS"),
        ((project.table, "--all-pairs", "*.ply"), "PAIRS"),
        (("--all-pairs", tmp_path / "*.ply"), "at least two clouds"),
        ((project.table, "--ray-address", "auto"), "--engine ray"),
        ((project.table, "--viewpoint", "there"), "viewpoint"),
        ((project.table, "--cache", tmp_path / "no" / "such"), "--cache"),
        ((project.table, "--recall-meters", "inf"), "--recall-meters"),
        ((tmp_path / "nothing.csv",), "nothing.csv"),
    ]:
        refused = batch(*words)
        assert refused.exit_code == 2, words
        assert named in refused.stderr.replace("\n", ""), words
        assert not (tmp_path / "out").exists(), words
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("precious")
    refused = batch(project.table, out="full")
    assert refused.exit_code == 2
    assert "thesis.txt" in refused.stderr
    assert run("batch", project.table, "--out", tmp_path / "no" / "such" / "folder").exit_code == 2
