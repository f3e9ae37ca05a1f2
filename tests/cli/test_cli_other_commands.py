"""``info``, ``demo``, ``--help`` and ``--version``; interrupts, defects and closed pipes."""

import json
import re
import subprocess
import sys
from typing import get_args, get_type_hints

import pytest
import torch
import typer

import torchreg as tr
from torchreg.cli import app as app_module
from torchreg.cli.guard import GuardedGroup


def commands():
    group = typer.main.get_command(app_module.app)
    return group.commands


def test_info(run, room):
    result = run("info", room.source)
    assert result.exit_code == 0
    for words in ("ply binary_little_endian", "spacing", "extent", "inlier threshold", "uint8", "viewpoint"):
        assert words in result.stdout


def test_info_as_json(run, room):
    found = json.loads(run("info", room.source, "--json", "-").stdout, parse_constant=pytest.fail)
    cloud = tr.read_cloud(room.source)
    assert found["points_in_file"] == len(cloud.points)
    assert found["spacing"] == pytest.approx(float(tr.spacing(cloud)))
    assert found["options"]["normal_radius"] == pytest.approx(tr.derive_options(cloud, cloud)[0].normal_radius)
    assert found["viewpoint"] == pytest.approx((cloud.viewpoint[0] + cloud.origin[0]).tolist(), abs=1e-6)
    assert found["viewpoint_known"] is True
    assert found["cannot_be_registered"] is None
    none = json.loads(run("info", room.source, "--json", "-", "--viewpoint", "none").stdout)
    assert (none["viewpoint"], none["viewpoint_known"]) == (None, False)


def test_json_of_info_as_a_file(run, room, tmp_path):
    """As everywhere: a file beside the table, or standard output alone."""
    result = run("info", room.source, "--json", tmp_path / "i.json")
    assert "spacing" in result.stdout
    assert result.stderr == f"torchreg: wrote {tmp_path / 'i.json'}\n"
    assert json.loads((tmp_path / "i.json").read_text()) == json.loads(run("info", room.source, "--json", "-").stdout)
    assert run("info", room.source, "--json", tmp_path / "no" / "i.json").exit_code == 2


def test_info_tells_an_assumed_viewpoint_from_a_known_one(run, room, plain):
    path = plain(room.source)
    assert "the origin of the file's frame, assumed" in run("info", path).stdout
    assert "the origin of the file's frame, as asked for" in run("info", path, "--viewpoint", "origin").stdout
    for viewpoint in ("auto", "origin"):
        found = json.loads(run("info", path, "--json", "-", "--viewpoint", viewpoint).stdout)
        assert found["viewpoint"] == [0, 0, 0]
        assert found["viewpoint_known"] is (viewpoint == "origin")


def test_info_on_what_cannot_be_registered(run, cloud_file):
    path = cloud_file("same.ply", torch.ones(9, 3))
    assert "coincide" in run("info", path).stdout
    found = json.loads(run("info", path, "--json", "-").stdout)
    assert (found["options"], found["spacing"]) == (None, 0)
    assert "all 9 points of it coincide" in found["cannot_be_registered"]


def test_markup_and_escapes_in_names_are_text(run, tmp_path, room):
    path = tmp_path / "[red]a\x1b[31mb[bold].ply"
    with open(room.source, "rb") as file:
        path.write_bytes(file.read())
    shown = run("info", path).stdout.replace("\n", "")
    assert "\x1b" not in shown
    assert r"[red]a\x1b[31mb[bold].ply" in shown
    assert "\x1b" not in run("info", tmp_path / "\x1b[31m.ply").stderr


def test_demo(run, tmp_path):
    picture, out = tmp_path / "p.png", tmp_path / "out"
    result = run("demo", "--seed", "2", "--angular-step", "1", "--figure", picture, "--out", out)
    assert result.exit_code == 0, result.output
    for words in ("paper: FPFH alone", "paper: FPFH + PCFH", "plain, without color", "right"):
        assert words in result.stdout
    assert "of the matches are right" in result.stdout
    assert picture.stat().st_size > 10_000
    assert sorted(path.name for path in out.iterdir()) == ["result.json", "source.ply", "target.ply", "truth.txt"]
    again = run(
        *("register", out / "source.ply", out / "target.ply", "--truth", out / "truth.txt"),
        *("--seed", "2", "--json", "-"),
    )
    found, first = json.loads(again.stdout), json.loads((out / "result.json").read_text())
    assert found["truth"]["rmse_meters"] < found["options"]["solver"]["inlier_threshold"]
    assert found["T_target_source"] == first["T_target_source"]


def test_demo_leaves_nothing_behind_and_says_at_once_what_it_does(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run("demo", "--angular-step", "2")
    assert list(tmp_path.iterdir()) == []
    assert result.stderr.splitlines()[0] == "torchreg: scanning a simulated mall from two stations"
    assert "registering by default" in result.stderr
    assert "wrote" not in result.stderr
    assert "--figure" in result.stdout


def test_the_command_speaks_before_it_loads_pytorch():
    """The first line of the demo comes before anything of the package is imported."""
    code = """
import sys
import torchreg_command
sys.argv = ["torchreg", "demo", "--angular-step", "nonsense"]
class Spy:
    def find_spec(self, name, *_):
        if name == "torchreg":
            raise SystemExit("loading")
sys.meta_path.insert(0, Spy())
torchreg_command.main()
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=20)
    said, loading = ended.stderr.splitlines()
    assert said.startswith("torchreg: two scans of a simulated mall")
    assert loading == "loading"


RIDDLES = re.compile(r"\(an? (switch|name|text|path|count|number)\b|no unit|unless told|goes? on")
UNITS = {
    **{"METERS": "meters", "DEGREES": "degrees", "BYTES": "bytes", "PROBABILITY": "Probability"},
    **{"COUNT": "", "COUNT,COUNT": "", "NUMBER": "whole number", "1..5": "from 1 to 5"},
}


@pytest.mark.parametrize("name", [*commands(), *(f"bench {name}" for name in commands()["bench"].commands)])
def test_every_help_text_is_a_sentence_with_unit_and_default(name):
    group, _, one = name.rpartition(" ")
    command = (commands()[group].commands if group else commands())[one]
    kinds = get_type_hints(command.callback) if command.callback else {}
    for parameter in command.params:
        text = parameter.help
        assert text, (name, parameter.name)
        assert text[0].isupper(), (name, text)
        assert text.endswith("."), (name, text)
        assert not RIDDLES.search(text), (name, text)
        kind = kinds.get(parameter.name)
        if {int, float} & {kind, *get_args(kind)}:
            assert UNITS[parameter.metavar] in text, (name, text)
            assert parameter.default is not None or parameter.required or "by default" in text, (name, text)


@pytest.mark.parametrize("command", [[], ["register"], ["check"], ["info"], ["convert"], ["demo"]])
def test_help(run, command):
    result = run(*command, "--help")
    assert result.exit_code == 0
    assert "Usage" in result.stdout
    if command:
        assert "meters" in result.stdout
        assert re.search(r"Exit code\W+0", result.stdout)


def test_bare_command_shows_the_help(run):
    result = run()
    assert result.exit_code == 2
    assert "register" in result.output


def test_version(run):
    assert run("--version").stdout == f"torchreg {tr.__version__}\n"


def guarded(body):
    broken = typer.Typer(cls=GuardedGroup, pretty_exceptions_enable=False)
    broken.command("a")(body)
    broken.command("b")(lambda: None)
    return broken


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (ValueError("no [bold]such[/bold] thing"), 2, "no [bold]such[/bold] thing"),
        (tr.errors.CloudFileError("a.ply: cut short"), 2, "a.ply: cut short"),
        (PermissionError(13, "Permission denied", "a.ply"), 2, "a.ply"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (RuntimeError("out of luck"), 1, "unexpected RuntimeError: out of luck"),
        (MemoryError(), 1, "unexpected MemoryError"),
        (IndexError("7"), 1, "TORCHREG_DEBUG=1"),
    ],
)
def test_errors_become_messages(monkeypatch, error, code, words):
    from typer.testing import CliRunner

    def body():
        raise error

    monkeypatch.delenv("TORCHREG_DEBUG", raising=False)
    result = CliRunner().invoke(guarded(body), ["a"])
    assert result.exit_code == code
    assert words in result.stderr
    assert "Traceback" not in result.output
    monkeypatch.setenv("TORCHREG_DEBUG", "1")
    if not isinstance(error, KeyboardInterrupt):
        with pytest.raises(type(error)):
            CliRunner().invoke(guarded(body), ["a"], catch_exceptions=False)


def test_help_imports_nothing_heavy():
    code = """
import sys
from torchreg.cli import main
sys.argv = ["torchreg", "--help"]
try:
    main()
except SystemExit as end:
    assert end.code == 0
print([name for name in ("open3d", "matplotlib", "kornia") if name in sys.modules])
"""
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.rstrip().endswith("[]")
    assert "register" in found.stdout


def test_module_and_closed_pipe(room):
    """``python -m torchreg info FILE | true``: no traceback, and no success either."""
    command = [sys.executable, "-m", "torchreg", "info", room.source, "--json", "-"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    message = process.stderr.read().decode()
    process.stderr.close()
    assert process.wait() != 0
    assert "Traceback" not in message
    assert "Exception" not in message
