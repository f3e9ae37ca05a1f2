"""Ratios of lengths fall into the bins that torch puts them in, also on an edge; those too short are left out."""

import math

import pytest
import torch
from determinism import same_bits

from torchreg.native import native_kernels, native_library
from torchreg.verification.length_ratios import _counted, _pairs, length_ratios

pytestmark = pytest.mark.skipif(not native_library(), reason="no compiler was at hand when the package was installed")


def matches(count, factor, seed):
    g = torch.Generator().manual_seed(seed)
    source = 5 * torch.rand(count, 3, generator=g, dtype=torch.float64)
    target = factor * source + 0.01 * torch.randn(count, 3, generator=g, dtype=torch.float64)
    target[: count // 2] = target[torch.randperm(count, generator=g)][: count // 2]
    return source, target


@pytest.mark.parametrize("count", [2, 3, 100, 1000, 40_000])
@pytest.mark.parametrize("factor", [0.0, 0.05, 0.6, 1.0, 3.0, 100.0])
def test_counts_are_those_of_torch(count, factor):
    source, target = matches(count, factor, seed=count)
    ends = _pairs(count, source.device)
    with native_kernels(False):
        expected = _counted(source, target, *ends, 0.01), length_ratios(source, target, 0.01)
    assert same_bits((_counted(source, target, *ends, 0.01), length_ratios(source, target, 0.01)), expected)


def test_ratios_at_the_edges_of_bins():
    edges = [math.exp(0.02 * (bin + 0.5)) for bin in range(-140, 140)]
    ratios = [0.0, 1e-300, 1e300, math.inf, math.nan]
    for edge in edges:
        ratios += [edge, math.nextafter(edge, 0.0), math.nextafter(edge, math.inf)]
    # lengths along one axis, from the origin: their squares are the ratios, or nearly so
    source, target = torch.zeros(len(ratios) + 1, 3).double(), torch.zeros(len(ratios) + 1, 3).double()
    source[1:, 0], target[1:, 0] = 1.0, torch.tensor(ratios, dtype=torch.float64).sqrt()
    ends = torch.zeros(len(ratios), dtype=torch.int64), torch.arange(1, len(ratios) + 1)
    with native_kernels(False):
        expected = _counted(source, target, *ends, 1e-6)
    assert same_bits(_counted(source, target, *ends, 1e-6), expected)
    assert int(expected[1][0]) >= 3 * len(edges)
