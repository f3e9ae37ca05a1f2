"""The notebooks run as they stand, and what they say about themselves is true."""

import json
import re
import runpy
from pathlib import Path

import pytest
import torch

FOLDER = Path(__file__).parents[2] / "notebooks"


@pytest.fixture
def run(monkeypatch):
    """Run a notebook's text from above; returns its names, and how many figures it showed."""
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg", force=True)
    from matplotlib import pyplot as plt

    shown = []

    def show():
        shown.extend(plt.get_fignums())
        plt.close("all")

    monkeypatch.setattr(plt, "show", show)

    def notebook(name):
        names = runpy.run_path(str(FOLDER / f"{name}.py"), run_name="__main__")
        return names, len(shown)

    before = torch.random.get_rng_state()
    yield notebook
    torch.random.set_rng_state(before)


def test_the_pipeline_ends_at_the_truth_and_shows_every_stage(run, capsys):
    names, figures = run("pipeline")
    assert figures == 6
    assert bool(names["whole"].success)
    assert names["errors"][0] < 0.1
    assert names["shares"]["the default: FPFH, contrast, PCFH"] > 1.5 * names["shares"]["FPFH alone"]
    assert "mutual matches" in capsys.readouterr().out


def test_batches_are_the_same_bits_alone(run, capsys):
    names, figures = run("batches")
    assert figures == 1
    assert names["same"]
    assert names["result"].success.tolist() == [True] * 6 + [False] * 2
    assert max(names["angle"]) < 0.5
    assert "bit for bit: True" in capsys.readouterr().out


def test_gradients_lower_the_pose_loss(run):
    names, figures = run("gradients")
    assert figures == 3
    assert names["history"][-1][0] < names["history"][0][0]
    assert names["away"] == sorted(names["away"], reverse=True)


@pytest.mark.slow
def test_what_is_learned_holds_in_a_hall_not_seen(run):
    names, figures = run("sensitivity")
    assert figures == 2
    assert names["learned_ratio"](names["unseen"]) > names["fixed"]


def cells_of_text(path):
    """(kind, source) of every cell of a percent text."""
    cells = []
    for part in re.split(r"^# %%", path.read_text(), flags=re.M)[1:]:
        kind, _, body = part.partition("\n")
        if "[markdown]" in kind:
            cells.append(("markdown", re.sub(r"^# ?", "", body.strip(), flags=re.M)))
        else:
            cells.append(("code", body.strip()))
    return cells


@pytest.mark.parametrize("name", sorted(path.stem for path in FOLDER.glob("*.py")))
def test_the_executed_notebook_is_that_of_the_text(name):
    notebook = json.loads((FOLDER / f"{name}.ipynb").read_text())
    cells = [(cell["cell_type"], "".join(cell["source"]).strip()) for cell in notebook["cells"]]
    assert cells == cells_of_text(FOLDER / f"{name}.py")
    outputs = [output for cell in notebook["cells"] for output in cell.get("outputs", [])]
    assert outputs
    assert not any(output["output_type"] == "error" for output in outputs)
