"""Poses weighed on matches by the compiled kernel have the bits that torch computes, for any number of threads."""

import pytest
import torch
from determinism import same_bits, threads
from problems import random_transform

from torchreg.native import native_kernels, native_library
from torchreg.verification.agreement import MatchEndpoints, agreement, match_cells

pytestmark = pytest.mark.skipif(not native_library(), reason="no compiler was at hand when the package was installed")


def problem(matches, poses, seed):
    """Matches of which a part agrees under the first pose, some of them several times the same."""
    g = torch.Generator().manual_seed(seed)
    T = torch.stack([random_transform(g).double() for _ in range(poses)]) if poses else torch.zeros(0, 4, 4).double()
    source = torch.rand(matches, 3, generator=g, dtype=torch.float64) * 5
    source = source[torch.randint(max(1, matches), (matches,), generator=g)] if matches else source
    target = source + 0.05 * torch.randn(matches, 3, generator=g, dtype=torch.float64)
    if poses:
        target = target @ T[0, :3, :3].t() + T[0, :3, 3]
    return MatchEndpoints(source, target), T[:, :3, :3], T[:, :3, 3]


@pytest.mark.parametrize("matches", [0, 1, 2, 63, 512, 513, 1500])
@pytest.mark.parametrize("poses", [0, 1, 7, 30])
def test_kernel_and_torch_agree_in_every_bit(matches, poses):
    matched, rotation, translation = problem(matches, poses, seed=matches + poses)
    cells = match_cells(matched, 0.1)
    with native_kernels(False):
        expected = agreement(cells, rotation, translation)
    for count in (1, 2, 3):
        with threads(count):
            assert same_bits(agreement(cells, rotation, translation), expected)
    if matches > 100 and poses:
        assert int(expected.support[0]) > matches // 3


def test_coordinates_that_are_no_numbers_agree_with_nothing():
    matched, rotation, translation = problem(100, 3, seed=0)
    translation[0] = float("nan")
    translation[1] = float("inf")
    cells = match_cells(matched, 0.1)
    with native_kernels(False):
        expected = agreement(cells, rotation, translation)
    assert same_bits(agreement(cells, rotation, translation), expected)
    assert expected.support[:2].tolist() == [0, 0]
