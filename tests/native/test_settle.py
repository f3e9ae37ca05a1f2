"""The kernels by which surfels settle have the bits of torch."""

import pytest
import torch
from determinism import same_bits
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import turned
from surfaces import REACH, surfels_of_both, two_rooms

from torchreg.geometry.numerics.roots import square_root
from torchreg.native import native_kernels, native_library
from torchreg.refinement.blocks import Blocks
from torchreg.refinement.pairing import Pairing, enter
from torchreg.refinement.settle import SurfelPairs
from torchreg.refinement.spread import medians, normal_equations
from torchreg.refinement.surfels import Surfels

pytestmark = pytest.mark.skipif(not native_library(), reason="no compiler was at hand when the package was installed")

EYE = torch.eye(4, dtype=torch.float64)
NEAR = turned(0.3, (1.0, 2.0, 3.0), (0.03, -0.02, 0.02))


@pytest.fixture(scope="module")
def rooms():
    """The surfels of two pairs, of different numbers."""
    pairs = [two_rooms(EYE, spacing=spacing, seed=seed) for seed, spacing in enumerate((0.2, 0.15))]
    return [Surfels.pack(each) for each in zip(*(surfels_of_both(pair, 1000) for pair in pairs), strict=True)]


def settled(rooms):
    pairs = SurfelPairs(*rooms, Pairing([0, 1], [0, 1]))
    return pairs.settle(*enter(pairs.frames, torch.stack([NEAR, EYE])), torch.full((2,), REACH, dtype=torch.float64))


def test_surfels_settle_with_the_bits_of_torch(rooms):
    with native_kernels(False):
        expected = settled(rooms)
    before = torch.get_num_threads()
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            state = settled(rooms)
            assert state.updates == expected.updates
            assert state.solvable == expected.solvable == [True, True]
            assert same_bits(state.rotation, expected.rotation)
            assert same_bits(state.translation, expected.translation)
            assert same_bits(tuple(state.spread), tuple(expected.spread))
            alike = expected.residuals.alike
            assert torch.equal(state.residuals.alike, alike)
            for name in ("distance", "variance"):
                assert same_bits(getattr(state.residuals, name)[alike], getattr(expected.residuals, name)[alike])
            for name in ("normal", "turned"):
                assert same_bits(getattr(state.residuals, name)[:, alike], getattr(expected.residuals, name)[:, alike])
            sums = normal_equations(state.residuals, state.matches, state.spread)
            with native_kernels(False):
                assert torch.equal(sums, normal_equations(state.residuals, state.matches, state.spread))
    finally:
        torch.set_num_threads(before)


@given(
    st.lists(st.integers(1, 4000), min_size=1, max_size=4), st.integers(0, 2**31), st.sampled_from([0, 0.01, 0.5, 1])
)
@settings(max_examples=25, deadline=None)
def test_medians_are_those_of_torch(lengths, seed, share):
    generator = torch.Generator().manual_seed(seed)
    blocks = Blocks.of(lengths, torch.device("cpu"))
    values = torch.randn(blocks.real.shape, dtype=torch.float64, generator=generator)
    if seed % 3 == 0:
        values = values.mul(3).round()
    if seed % 3 == 1:
        values = values.view(-1).sort().values.view(values.shape).contiguous()
    values[0, 0] = torch.nan if seed % 2 else 0.0
    kept = (torch.rand(values.shape, generator=generator) < share) & blocks.real
    found = medians(values, kept, blocks)
    with native_kernels(False):
        assert torch.equal(found.nan_to_num(99), medians(values, kept, blocks).nan_to_num(99))


def test_square_roots_are_as_torch_has_them_but_for_the_last_bit():
    values = torch.rand(5000, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) * 100
    assert (square_root(values) / values.sqrt() - 1).abs().max() < 5e-16
    assert square_root(torch.tensor([0.0, -1.0, 4.0])).tolist() == [0.0, 0.0, 2.0]
