"""Soft equalization: the hard one in the limit, monotone, with true derivatives."""

import pytest
import torch
from closeness import close
from determinism import THREADS, same_bits, threads
from gradients import assert_derivatives
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refuses

import torchreg as tr
from torchreg.descriptors.color import equalize


def hues(count, seed=0, dtype=torch.float64):
    return torch.rand(count, dtype=dtype, generator=torch.Generator().manual_seed(seed)) ** 2


def whole(hue):
    return torch.tensor([0, len(hue)])


@pytest.mark.parametrize("count", [1, 2, 10, 3000])
def test_a_narrow_bandwidth_gives_the_hard_map(count):
    hue = hues(count)
    assert close(tr.soft_equalize(hue, whole(hue), 1e-9), equalize(hue, whole(hue)), atol=1e-6)


@settings(max_examples=40)
@given(st.lists(st.floats(0, 1, width=32), min_size=1, max_size=30), st.sampled_from([1.0, 0.3]))
def test_the_map_is_monotone_and_spans_the_unit_interval(values, bandwidth):
    hue = torch.tensor(values, dtype=torch.float64)
    mapped = tr.soft_equalize(hue, whole(hue), bandwidth)
    order = hue.argsort()
    assert mapped[order].diff().min() >= -1e-12 if len(values) > 1 else True
    assert mapped.min() == 0
    assert mapped.max() <= 1 + 1e-12


def test_many_hues_become_more_uniform_than_by_the_hard_map():
    hue = hues(20_000)
    uniform = torch.linspace(0, 1, len(hue), dtype=torch.float64)
    soft, hard = (equalizer(hue, whole(hue)).sort().values for equalizer in (tr.soft_equalize, equalize))
    assert (soft - uniform).abs().mean() < (hard - uniform).abs().mean()


def test_derivatives_are_true():
    hue = hues(12).requires_grad_()
    for bandwidth in (1.0, 0.5):
        assert_derivatives(lambda value, b=bandwidth: tr.soft_equalize(value, torch.tensor([0, 5, 12]), b), (hue,))


@pytest.mark.parametrize("values", [[0.25] * 6, [0.0, 1.0, 0.0, 1.0], [0.5]])
def test_derivatives_are_finite_for_hues_that_are_equal(values):
    hue = torch.tensor(values, requires_grad=True)
    mapped = tr.soft_equalize(hue, whole(hue))
    (grad,) = torch.autograd.grad(mapped.square().sum(), hue)
    assert torch.isfinite(mapped).all()
    assert torch.isfinite(grad).all()


def test_every_cloud_is_equalized_by_itself_and_threads_change_no_bit():
    hue, offsets = hues(60_000, dtype=torch.float32), torch.tensor([0, 100, 100, 60_000])
    expected = tr.soft_equalize(hue, offsets)
    alone = torch.cat([tr.soft_equalize(part, whole(part)) for part in (hue[:100], hue[100:])])
    assert same_bits(expected, alone)
    for number in THREADS:
        with threads(number):
            assert same_bits(tr.soft_equalize(hue, offsets), expected)


def test_what_does_not_fit_is_refused():
    with refuses("hue", "P", "2"):
        tr.soft_equalize(torch.zeros(3, 2), torch.tensor([0, 3]))
    with refuses("bandwidth", "(0, 1]"):
        tr.soft_equalize(torch.zeros(3), torch.tensor([0, 3]), 2)
