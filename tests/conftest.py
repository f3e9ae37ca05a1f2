"""Settings that all tests share."""

import os

import pytest
import torch
from hypothesis import settings
from stand_in import NAME

# Some tests run with more threads than the machine has free cores: waiting threads should sleep, not spin.
# OpenMP reads this once, when torch loads it.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

# The same examples on every run, and no limit of time, since machines differ.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.load_profile("repeatable")


def pytest_addoption(parser):
    parser.addoption(
        "--device",
        default=NAME,
        help="where tests/device/ computes beside the CPU: cuda, cpu, or meta, a stand-in for a GPU (default)",
    )


@pytest.fixture
def device(request):
    """The device beside the CPU, as PyTorch names it."""
    name = request.config.getoption("--device")
    if torch.device(name).type == "cuda" and not torch.cuda.is_available():
        pytest.skip(f"--device {name}: PyTorch finds no GPU")
    return name
