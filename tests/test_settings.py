"""Settings are declared once: what a field says holds for options, columns, help and validation."""

import json
import re
from dataclasses import dataclass, replace

import pytest
import typer
from refusals import refuses
from typer.testing import CliRunner

from torchreg.cli.app import app
from torchreg.cli.expand import expanded
from torchreg.declaration import declared, setting
from torchreg.registration import PAPER
from torchreg.settings import PairSettings, Settings, StageSettings

SETTINGS = declared(PairSettings)
COMMANDS = {"register": Settings, "batch": PairSettings, "check": StageSettings}
CELLS = {int: "700", float: "0.5", bool: "yes", str: "none"}


def options_of(command):
    """The parameters of a command by the name of its option."""
    known = typer.main.get_command(app).commands[command]
    return {option: parameter for parameter in known.params for option in parameter.opts}


@pytest.mark.parametrize("name", SETTINGS)
@pytest.mark.parametrize("command", COMMANDS)
def test_every_setting_is_an_option_of_the_commands_that_take_it(command, name):
    options, flag = options_of(command), f"--{name.replace('_', '-')}"
    assert (flag in options) == (name in declared(COMMANDS[command]))
    if flag in options:
        assert options[flag].help == SETTINGS[name].setting.help
        shown = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "1000"}).stdout
        assert SETTINGS[name].setting.help in shown


@pytest.mark.parametrize("name", SETTINGS)
def test_every_setting_is_remembered_and_a_column(name):
    kind, known = SETTINGS[name]
    cell = known.choices[-1] if known.choices else CELLS[kind]
    base = PairSettings(solver="ransac" if known.of_ransac else None)
    changed = base.with_columns({name: cell}, "t.csv, line 3")
    assert list(changed.flat()) == list(SETTINGS)
    assert changed.flat() == base.flat() | {name: {"yes": True}.get(cell, kind(cell))}
    assert json.loads(json.dumps(changed.flat())) == changed.flat()
    assert re.search(rf"for that pair alone:.*\b{name}\b", options_of("batch")["pairs"].help)


@pytest.mark.parametrize("name", SETTINGS)
def test_every_setting_says_what_it_is(name):
    kind, known = SETTINGS[name]
    assert known.help[0].isupper()
    assert known.help.endswith(".")
    assert not re.search(r"\((a|an) \w+\)|unless told", known.help)
    if kind is float and known.metavar == "METERS":
        assert "meters" in known.help
    if getattr(PairSettings(), name) is None:
        assert "by default" in known.help
    if known.change is not None:
        value = True if kind is bool else known.choices[1] if known.choices else kind(CELLS[kind])
        assert known.change(PAPER, value) != PAPER


def _with_ratio(options, value):
    return replace(options, ratio=value)


def test_one_more_field_is_one_more_option_column_and_key():
    @dataclass(frozen=True, kw_only=True)
    class More(Settings):
        ratio: float | None = setting(
            None, "Search", "Distance ratio of a match, no unit; by default none.", change=_with_ratio
        )
        color: str = setting("red", "Search", "Color.", choices=("red", "blue"))

    given = []

    @expanded
    def command(settings: More) -> None:
        """Take settings."""
        given.append(settings)

    small = typer.Typer()
    small.command()(command)
    shown = CliRunner().invoke(small, ["--help"], env={"COLUMNS": "200"}).stdout
    assert "Distance ratio of a match" in shown
    assert "<red|blue>" in shown
    assert CliRunner().invoke(small, ["--ratio", "0.8", "--color", "blue"]).exit_code == 0
    assert given == [More(ratio=0.8, color="blue")]
    assert given[0].over(PAPER) == replace(PAPER, ratio=0.8)
    assert given[0].flat() == Settings().flat() | {"ratio": 0.8, "color": "blue"}
    assert More().with_columns({"ratio": "0.9", "color": "blue"}, "t") == More(ratio=0.9, color="blue")
    for cells, words in (
        ({"ratio": "wide"}, "expected a number"),
        ({"color": "green"}, "color"),
        ({"rato": "1"}, "rato"),
    ):
        with pytest.raises(ValueError, match=words):
            More().with_columns(cells, "t")


@pytest.mark.parametrize("name", ["hypotheses", "confidence"])
@pytest.mark.parametrize(
    ("beside", "read"),
    [
        ({}, False),
        ({"solver": "compatibility"}, False),
        ({"preset": "paper", "solver": "compatibility"}, False),
        ({"effort": "fast"}, False),
        ({"solver": "ransac"}, True),
        ({"preset": "paper"}, True),
        ({"effort": "thorough"}, True),
    ],
)
def test_what_no_solver_reads_is_refused(name, beside, read):
    if read:
        assert getattr(Settings(**beside, **{name: 1}), name) == 1
    else:
        words = f"{name}: expected the solver ransac or the effort thorough beside it, got"
        with pytest.raises(ValueError, match=words):
            Settings(**beside, **{name: 1})
    assert getattr(StageSettings(**{name: 1}), name) == 1


def test_cells_take_the_place_of_their_setting():
    settings = PairSettings(seed=2, voxel=0.1)
    changed = settings.with_columns({"voxel": "0.2", "seed": "7", "no_color": "yes", "scene": "hall"}, "t.csv, line 3")
    assert changed.flat() == {**settings.flat(), "voxel": 0.2, "seed": 7, "no_color": True}
    assert settings.with_columns({}, "t.csv, line 3") == settings


@pytest.mark.parametrize(
    ("columns", "named"),
    [
        ({"voxel": "wide"}, "column voxel: expected a number"),
        ({"seed": "1.5"}, "column seed: expected a whole number"),
        ({"no_color": "perhaps"}, "column no_color: expected true or false"),
        ({"efort": "fast"}, "column efort"),
        ({"voxel": "-1"}, "line 3: voxel: expected"),
        ({"confidence": "2"}, "confidence"),
        ({"solver": "luck"}, "solver"),
        ({"viewpoint": "1,2"}, "viewpoint"),
    ],
)
def test_cells_that_mean_nothing_are_refused_with_their_line(columns, named):
    with pytest.raises(ValueError, match=r"^t\.csv, line 3") as caught:
        PairSettings().with_columns(columns, "t.csv, line 3")
    assert named in str(caught.value)


@pytest.mark.parametrize(
    "bad", [{"preset": "best"}, {"effort": "huge"}, {"points": 0}, {"seed": 1.5}, {"viewpoint": "there"}]
)
def test_settings_that_mean_nothing_are_refused(bad):
    with refuses(next(iter(bad))):
        PairSettings(**bad)
