"""Every stage on another device: what the CPU finds, within what is stated, and seldom a wait for the host."""

import pytest
import torch
from stages import STAGES, differences, given, moved
from stand_in import NAME, StandIn

every_stage = pytest.mark.parametrize("name", STAGES)


@pytest.fixture(scope="module")
def inputs():
    return given(1200)


@every_stage
def test_a_stage_finds_on_a_device_what_it_finds_on_the_cpu(inputs, device, name):
    stage = STAGES[name]
    assert differences(stage.run(moved(inputs, device)), stage.run(inputs), stage) == []
