"""Every stage on another device (``--device``): what the CPU finds, as near as stated, seldom waiting for the host."""

from contextlib import nullcontext

import pytest
from determinism import pieces
from stages import STAGES, differences, given, moved
from stand_in import NAME, StandIn

QUICK = [name for name, stage in STAGES.items() if not stage.whole]
SMALL = [name for name in QUICK if STAGES[name].transfers <= 60]


@pytest.fixture(scope="module")
def inputs():
    return given(1200)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] if STAGES[name].whole else []) for name in STAGES]
)
def test_a_stage_finds_on_a_device_what_it_finds_on_the_cpu(inputs, device, name):
    stage = STAGES[name].on(device)
    with StandIn() if device == NAME else nullcontext() as stand_in:
        there = moved(inputs, device)
        if stand_in is not None:
            stand_in.transfers.clear()
        result = stage.run(there)
        if stand_in is not None:
            assert stand_in.transfers.total() <= stage.transfers, stand_in.transfers
        assert differences(result, stage.run(inputs), stage) == []


@pytest.mark.parametrize("name", SMALL)
def test_no_stage_waits_for_the_host_once_per_chunk(inputs, name):
    with StandIn() as stand_in, pieces(12_001):
        there = moved(inputs, NAME)
        stand_in.transfers.clear()
        STAGES[name].run(there)
    assert stand_in.transfers.total() <= STAGES[name].transfers, stand_in.transfers


def test_a_gpu_may_differ_more_and_the_stand_in_may_not():
    stage = STAGES["register, plain"]
    assert stage.on("cuda").atol > stage.on(NAME).atol == stage.atol


def test_differences_are_seen(inputs):
    stage = STAGES["neighbors"]
    result = stage.run(inputs)
    result.sq_distance[3, 1] += 1e-6
    (line,) = differences(result, stage.run(inputs), stage)
    assert line.startswith(".sq_distance: off by 1")
