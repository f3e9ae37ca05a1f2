"""``torchreg register``: what it writes, what it prints, and its exit code."""

import json

import numpy as np
import pytest
import torch
from pages import Page
from problems import room_pair

import torchreg as tr
from torchreg.io import read_transform_text


def test_all_outputs_of_a_good_pair(run, room, tmp_path):
    outputs = {name: tmp_path / name for name in ("result.json", "T.txt", "aligned.ply", "picture.png")}
    result = run(
        *("register", room.source, room.target, "--truth", room.truth, "--json", outputs["result.json"]),
        *("--transform", outputs["T.txt"], "--aligned", outputs["aligned.ply"], "--figure", outputs["picture.png"]),
    )
    assert result.exit_code == 0, result.output
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(outputs)
    assert f"torchreg: wrote {', '.join(map(str, outputs.values()))}\n" in result.stderr

    found = json.loads(outputs["result.json"].read_text(), parse_constant=pytest.fail)
    assert (found["success"], found["reason"], found["seed"]) == (True, "", 0)
    T = torch.tensor(found["T_target_source"], dtype=torch.float64)
    truth = read_transform_text(room.truth)
    assert tr.metrics.rre(truth, T) < 1.5
    assert tr.metrics.rte(truth, T) < 0.1
    assert found["truth"]["rre_degrees"] == pytest.approx(float(tr.metrics.rre(truth, T)))
    assert found["truth"]["rte_meters"] == pytest.approx(float(tr.metrics.rte(truth, T)))
    assert found["truth"]["rmse_meters"] < 0.1
    assert found["run"] == {"preset": "default", "points": None, "viewpoint": "auto", "device": "cpu"}
    assert torch.equal(read_transform_text(outputs["T.txt"]), T)
    np.testing.assert_array_equal(np.loadtxt(outputs["T.txt"]), T.numpy())

    source, aligned = tr.read_cloud(room.source), tr.read_cloud(outputs["aligned.ply"])
    assert found["points"]["source"] == {"in_file": len(source.points), "used": len(source.points)}
    torch.testing.assert_close(aligned.points, tr.transform(source, T).points + T[:3, 3].float(), atol=1e-4, rtol=0)
    assert torch.equal(aligned.colors, source.colors)


def test_the_transform_and_the_aligned_cloud_in_other_formats(run, room, tmp_path):
    pair = ("register", room.source, room.target, "--json", tmp_path / "r.json")
    words = ("--transform", tmp_path / "T.json", "--transform-format", "pdal", "--aligned", tmp_path / "a.laz")
    result = run(*pair, *words)
    assert result.exit_code == 0, result.output
    T = torch.tensor(json.loads((tmp_path / "r.json").read_text())["T_target_source"], dtype=torch.float64)
    (stage,) = json.loads((tmp_path / "T.json").read_text())
    assert [float(word) for word in stage["matrix"].split()] == T.flatten().tolist()
    source, aligned = tr.read_cloud(room.source), tr.read_cloud(tmp_path / "a.laz", dtype=torch.float64)
    moved = source.points.double() @ T[:3, :3].T + T[:3, 3]
    assert (aligned.points + aligned.origin - moved).abs().max() < 1e-4


def test_table_says_what_was_found(run, room):
    result = run("register", room.source, room.target, "--truth", room.truth)
    for words in ("inlier threshold", "fpfh", "hypotheses", "fitness", "inlier_rmse", "T_target_source", "RRE", "RMSE"):
        assert words in result.stdout
    assert result.stdout.rstrip().endswith("registered")
    assert "not registered" not in result.stdout
    assert room.source in result.stdout.replace("\n", "")
    assert "0.00000000000 0.00000000000" in " ".join(result.stdout.split())
    assert "wrote" not in result.stderr


def test_json_on_standard_output_stands_alone(run, room):
    result = run("register", room.source, room.target, "--json", "-", "--seed", "5")
    found = json.loads(result.stdout, parse_constant=pytest.fail)
    assert (found["seed"], found["success"], found["truth"]) == (5, True, None)
    assert found["versions"]["torchreg"]
    assert "registered" in result.stderr


def test_the_same_seed_gives_the_same_result(run, room):
    def transform(seed):
        found = run("register", room.source, room.target, "--json", "-", "--seed", seed, "--points", "3000")
        return json.loads(found.stdout)

    first, again, other = transform("1"), transform("1"), transform("2")
    assert first["T_target_source"] == again["T_target_source"]
    assert first["T_target_source"] != other["T_target_source"]
    assert first["points"]["source"]["used"] == 3000


def test_options_stand_over_the_preset(run, room):
    lengths = [
        "--normal-radius",
        "0.3",
        "--feature-radius",
        "0.6",
        "--color-radius",
        "0.5",
        "--inlier-threshold",
        "0.11",
    ]
    words = [*lengths, "--hypotheses", "9000", "--confidence", "1", "--no-color", "--preset", "paper"]
    found = json.loads(run("register", room.source, room.target, "--json", "-", *words).stdout)
    options = found["options"]
    assert (options["normal_radius"], options["voxel_size"], options["weights"]) == (0.3, None, [1.0])
    (geometry,) = options["descriptors"]
    assert (geometry["name"], geometry["radius"]) == ("fpfh", 0.6)
    assert geometry["max_neighbors"] == tr.PAPER.feature_max_neighbors
    solver = options["solver"]
    assert (solver["name"], solver["inlier_threshold"], solver["confidence"]) == ("ransac", 0.11, 1)
    assert found["counts"]["hypotheses_drawn"] <= 9000 == solver["hypotheses"]


def test_voxel_sets_the_scale_of_what_is_not_given(run, room):
    def options(*words):
        return json.loads(run("register", room.source, room.target, "--json", "-", *words).stdout)["options"]

    fine, coarse = options(), options("--voxel", "0.3", "--inlier-threshold", "0.2")
    assert coarse["voxel_size"] == 0.3
    assert coarse["solver"]["inlier_threshold"] == 0.2
    assert 0.4 < coarse["normal_radius"] < 0.9  # twice the spacing, which is about the voxel's edge
    assert coarse["normal_radius"] > 1.5 * fine["normal_radius"]


def test_viewpoint_is_handed_to_the_reader(run, room):
    result = run("register", room.source, room.target, "--viewpoint", "none")
    assert "no viewpoint for the source" in result.stdout
    assert "no viewpoint" not in run("register", room.source, room.target, "--viewpoint", "1,2,0.5").stdout


def test_a_plain_file_is_said_to_have_an_assumed_viewpoint_only(run, room, plain):
    bare = [plain(path) for path in (room.source, room.target)]
    assumed = "position is only assumed for the source and the target"
    assert assumed in " ".join(run("register", *bare).stdout.split())
    assert "assumed" not in run("register", *bare, "--viewpoint", "origin").stdout
    assert "assumed" not in run("register", room.source, room.target).stdout


def test_threads(run, room):
    before = torch.get_num_threads()
    try:
        run("register", room.source, room.target, "--threads", "1")
        assert torch.get_num_threads() == 1
    finally:
        torch.set_num_threads(before)


def test_a_failed_registration_says_why_and_writes_no_transform(run, room, cloud_file, tmp_path):
    line = cloud_file("line.ply", torch.linspace(0, 5, 200)[:, None] * torch.tensor([1.0, 2.0, 0.5]))
    outputs = {name: tmp_path / name for name in ("r.json", "T.txt", "a.ply", "p.png", "m.png", "p.html")}
    result = run(
        *("register", line, room.target, "--json", outputs["r.json"], "--transform", outputs["T.txt"]),
        *("--aligned", outputs["a.ply"], "--figure", outputs["p.png"], "--matches", outputs["m.png"], "--explain"),
        *("--report", outputs["p.html"]),
    )
    assert result.exit_code == 3
    assert "not registered: a degenerate cloud" in result.stdout
    assert "T_target_source" not in result.stdout
    assert [name for name, path in outputs.items() if path.exists()] == ["r.json", "p.png", "m.png", "p.html"]
    assert "Not registered" in Page(outputs["p.html"].read_text(encoding="utf-8")).text("p")
    found = json.loads(outputs["r.json"].read_text(), parse_constant=pytest.fail)
    assert found["success"] is False
    assert found["reason"] in result.stdout


@pytest.fixture(scope="module")
def strangers(room, tmp_path_factory):
    """A cloud that is not of the room; registered to it, it is refused with a likeliest pose."""
    folder = tmp_path_factory.mktemp("strangers")
    tr.write_cloud(folder / "other.ply", room_pair(3000, seed=5, scale=0.8).source)
    return folder / "other.ply"


def test_a_refused_pair_keeps_its_likeliest_pose_apart_and_is_judged(run, room, strangers, tmp_path):
    result = run(
        *("register", strangers, room.target, "--truth", room.truth, "--json", tmp_path / "r.json"),
        *("--transform", tmp_path / "T.txt", "--aligned", tmp_path / "a.ply", "--figure", tmp_path / "p.png"),
    )
    assert result.exit_code == 3, result.output
    assert sorted(path.name for path in tmp_path.iterdir()) == ["p.png", "r.json"]
    found = json.loads((tmp_path / "r.json").read_text(), parse_constant=pytest.fail)
    assert (found["T_target_source"], found["quaternion"], found["translation"]) == (None, None, None)
    likeliest = torch.tensor(found["likeliest_T_target_source"], dtype=torch.float64)
    truth = read_transform_text(room.truth)
    assert found["truth"]["rre_degrees"] == pytest.approx(float(tr.metrics.rre(truth, likeliest)))
    assert "the likeliest pose, which was refused: RRE" in result.stdout
    assert f"{tmp_path / 'T.txt'} and {tmp_path / 'a.ply'} not written: the pair was refused (--force" in result.stderr
    assert f"wrote {tmp_path / 'r.json'}, {tmp_path / 'p.png'}\n" in result.stderr


def test_force_writes_by_the_likeliest_pose_and_says_so(run, room, strangers, tmp_path):
    words = ("--transform", tmp_path / "T.txt", "--aligned", tmp_path / "a.ply", "--force")
    result = run("register", strangers, room.target, "--json", tmp_path / "r.json", *words)
    assert result.exit_code == 3
    likeliest = json.loads((tmp_path / "r.json").read_text())["likeliest_T_target_source"]
    assert read_transform_text(tmp_path / "T.txt").tolist() == likeliest
    assert len(tr.read_cloud(tmp_path / "a.ply").points) == len(tr.read_cloud(strangers).points)
    assert "by the likeliest pose of a refused pair, which is not trusted" in result.stderr


def test_force_has_nothing_to_write_without_a_pose(run, room, cloud_file, tmp_path):
    result = run(
        "register", cloud_file("two.ply", torch.eye(3)[:2]), room.target, "--transform", tmp_path / "T", "--force"
    )
    assert result.exit_code == 3
    assert "not written: no pose was found" in result.stderr
    assert not (tmp_path / "T").exists()


def test_the_figure_of_a_refused_pair_has_its_likeliest_pose(run, room, strangers, tmp_path, monkeypatch):
    headings = []
    monkeypatch.setattr(
        "torchreg.report.save_figure",
        lambda figure, path: headings.append([figure.get_suptitle(), *(ax.get_title() for ax in figure.axes)]),
    )
    assert run("register", strangers, room.target, "--figure", tmp_path / "p.png").exit_code == 3
    ((title, *columns),) = headings
    assert "likeliest pose, refused" in columns
    assert title.startswith("other.ply to target.ply: not registered (")


def test_a_long_step_is_named_on_a_line_where_there_is_no_terminal(run, room, monkeypatch):
    monkeypatch.setattr("torchreg.cli.progress._SHORT_STEP", 0.0)
    monkeypatch.setattr("torchreg.cli.progress._SILENT_SECONDS", 0.0)
    result = run("register", room.source, room.target, "--json", "-")
    assert "torchreg: registering source.ply to target.ply\n" in result.stderr
    json.loads(result.stdout)
    monkeypatch.setattr("torchreg.cli.progress._SHORT_STEP", 1e3)
    assert "registering" not in run("register", room.source, room.target, "--json", "-").stderr


def test_a_failure_under_json_keeps_the_reason_on_standard_error(run, room, cloud_file):
    result = run("register", cloud_file("two.ply", torch.eye(3)[:2]), room.target, "--json", "-")
    assert result.exit_code == 3
    assert json.loads(result.stdout)["success"] is False
    assert "not registered: too few points" in result.stderr


def test_how_certain_a_pose_is_stands_in_the_table_and_in_json(run, room):
    text = run("register", room.source, room.target).stdout
    for words in ("overlap", "strength", "runner-up", "probability"):
        assert words in text
    found = json.loads(run("register", room.source, room.target, "--json", "-").stdout, parse_constant=pytest.fail)
    assert 0.5 < found["probability"] <= 1
    assert 0.2 < found["overlap"] <= 1
    assert 0 < found["strength"] <= 1
    assert torch.tensor(found["information"]).shape == (6, 6)
    assert found["stages"]["given"]["source"] == found["points"]["source"]["used"]
    assert found["candidates"][0]["matches"] > 0
    assert found["stages"]["proposals"]


def test_explain(run, room):
    """After the table, word for word what the result says; beside JSON on standard error."""
    result = run("register", room.source, room.target, "--explain")
    assert result.exit_code == 0
    table, _, explained = result.stdout.partition("\n\n")
    assert table.rstrip().endswith("registered")
    source, target = tr.read_cloud(room.source), tr.read_cloud(room.target)
    assert explained.rstrip("\n") == tr.register(source, target).explain()
    assert "May help" not in run("register", room.source, room.target).stdout
    beside = run("register", room.source, room.target, "--explain", "--json", "-")
    assert json.loads(beside.stdout)["success"]
    assert explained.strip() in beside.stderr


@pytest.mark.parametrize(
    ("words", "effort", "solver"),
    [
        ([], "balanced", "compatibility"),
        (["--effort", "fast"], "fast", "compatibility"),
        (["--effort", "plain", "--solver", "ransac"], "plain", "ransac"),
        (["--voxel", "0.2"], "balanced", "compatibility"),
        (["--preset", "paper", "--feature-radius", "0.6"], "plain", "ransac"),
        (["--preset", "paper", "--feature-radius", "0.6", "--solver", "compatibility"], "plain", "compatibility"),
        (["--preset", "paper", "--effort", "balanced"], "balanced", "ransac"),
    ],
)
def test_effort_and_solver(run, room, words, effort, solver):
    """What is not told stays as the preset has it."""
    found = json.loads(run("register", room.source, room.target, "--json", "-", *words).stdout)
    assert (found["options"]["effort"], found["options"]["solver"]["name"]) == (effort, solver)
    origins = [proposal["origin"] for proposal in found["stages"]["proposals"]]
    assert origins[0].endswith(solver)
    assert (len(origins) > 1) == (effort == "balanced")
    assert (found["probability"] is None) == (effort == "plain")


def test_the_picture_of_the_matches(run, room, tmp_path):
    pictures = [tmp_path / name for name in ("all.png", "some.pdf")]
    assert run("register", room.source, room.target, "--matches", pictures[0]).exit_code == 0
    assert pictures[0].read_bytes().startswith(b"\x89PNG")
    words = ("--matches", pictures[1], "--points", "2000", "--voxel", "0.2")
    assert run("register", room.source, room.target, *words).exit_code == 0
    assert pictures[1].read_bytes().startswith(b"%PDF")


def test_the_page_on_a_pair(run, room, tmp_path):
    path = tmp_path / "room.html"
    result = run("register", room.source, room.target, "--report", path, "--truth", room.truth, "--points", "3000")
    assert result.exit_code == 0, result.output
    page = Page(path.read_text(encoding="utf-8"))
    assert "torchreg: source.ply to target.ply" in page.text("h1")
    assert f"{room.source}: 3,000 of " in page.text("td")
    assert "RRE" in page.text("td")
    assert "Registered" in page.text("p")


@pytest.mark.real
def test_a_kitchen(run, tmp_path):
    from pathlib import Path

    folder = Path(__file__).resolve().parents[3] / "shared" / "data" / "real"
    if not folder.is_dir():
        pytest.skip(f"no real scan pairs at {folder}")
    pairs = {pair["name"]: pair for pair in json.loads((folder / "pairs.json").read_text())["pairs"]}
    pair = pairs["redkitchen_19_05"]
    (tmp_path / "truth.json").write_text(json.dumps({"T_target_source": pair["T"]}))
    result = run(
        *("register", folder / pair["source"], folder / pair["target"], "--json", "-"),
        *("--truth", tmp_path / "truth.json"),
    )
    assert result.exit_code == 0, result.stderr
    truth = json.loads(result.stdout)["truth"]
    assert truth["rre_degrees"] < 5
    assert truth["rmse_meters"] < 0.1
