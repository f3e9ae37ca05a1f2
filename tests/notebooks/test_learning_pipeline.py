"""The learning example runs as it stands, and what it says about itself is true."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch

SCRIPT = Path(__file__).parents[2] / "notebooks" / "learning_pipeline.py"


@pytest.fixture
def example(monkeypatch):
    """The example as a module, which must do nothing when a spawned worker imports it."""
    spec = importlib.util.spec_from_file_location("learning_pipeline", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "learning_pipeline", module)
    spec.loader.exec_module(module)
    return module


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded, use of fork:DeprecationWarning")
def test_a_small_run(example, monkeypatch, capsys):
    monkeypatch.setattr(example, "TRAINING", range(1))
    monkeypatch.setattr(example, "HELD_OUT", range(1, 2))
    shares = example.main(steps=5)
    assert list(shares) == [
        f"{halls} halls, {kind}" for halls in ("training", "other") for kind in ("fused", "learned")
    ]
    assert all(0 < share < 1 for share in shares.values())
    assert "of nearest neighbors right" in capsys.readouterr().out


def test_only_points_far_from_the_partner_count_against_it(example):
    features = torch.eye(44)[:3]
    near = torch.tensor([[True, True, False]])
    alike = example.Described(features[:1], features[[0, 0, 2]], torch.tensor([0]), near)
    confused = example.Described(features[:1], features[[0, 2, 0]], torch.tensor([0]), near)
    net = torch.nn.Identity()
    assert float(example.info_nce(net, alike)) < 1e-6
    assert float(example.info_nce(net, confused)) > 0.5


@pytest.mark.slow
def test_the_script_learns_something_that_holds_in_other_halls():
    run = subprocess.run(
        [sys.executable, "-W", "error", str(SCRIPT)], capture_output=True, text=True, timeout=300, check=False
    )
    assert run.returncode == 0, run.stderr
    (before, after) = re.findall(r"([\d.]+)%", run.stdout.splitlines()[-1])
    assert run.stdout.splitlines()[-1].startswith("other halls: ")
    assert float(after) > 1.3 * float(before)
