"""Parameters named once in a dataclass are options of every command that takes it."""

import inspect
from dataclasses import dataclass
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from torchreg.cli.expand import expanded


@dataclass(frozen=True, kw_only=True)
class Place:
    x: Annotated[float, typer.Argument(help="Meters.")]
    height: Annotated[float, typer.Option("--height", help="Meters.")] = 0.5

    def __post_init__(self):
        if self.x < 0:
            raise ValueError("x: expected 0 or more")


SHOWN = []


@expanded
def show(place: Place, loud: Annotated[bool, typer.Option("--loud")] = False, times: int = 1) -> None:
    """Show a place."""
    SHOWN.append((place, loud, times))


def test_fields_are_parameters():
    parameters = inspect.signature(show).parameters
    assert list(parameters) == ["x", "height", "loud", "times"]
    assert parameters["x"].default is inspect.Parameter.empty
    assert (parameters["height"].default, parameters["times"].default) == (0.5, 1)
    assert set(show.__annotations__) == {*parameters, "return"}
    assert (show.__name__, show.__doc__) == ("show", "Show a place.")


@pytest.mark.parametrize(
    ("words", "seen"),
    [
        (["2"], (Place(x=2.0), False, 1)),
        (["2", "--height", "3", "--loud", "--times", "7"], (Place(x=2.0, height=3.0), True, 7)),
    ],
)
def test_a_command_gets_its_dataclass_filled(words, seen):
    app = typer.Typer()
    app.command()(show)
    SHOWN.clear()
    assert CliRunner().invoke(app, words).exit_code == 0
    assert [seen] == SHOWN


def test_a_call_by_hand_and_what_is_refused():
    SHOWN.clear()
    show(x=1.0, times=2)
    assert [(Place(x=1.0), False, 2)] == SHOWN
    with pytest.raises(TypeError, match="x"):
        show(times=2)
    with pytest.raises(TypeError, match="depth"):
        show(x=1.0, depth=2)
    with pytest.raises(ValueError, match="x: expected 0 or more"):
        show(x=-1.0)
