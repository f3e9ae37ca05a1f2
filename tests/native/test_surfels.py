"""The moments that surfels are made of have the bits of torch."""

import pytest
import torch
from determinism import same_bits
from hypothesis import given, settings
from hypothesis import strategies as st

import torchreg as tr
from torchreg.native import native_kernels, native_library
from torchreg.refinement.surfels import _planes

pytestmark = pytest.mark.skipif(not native_library(), reason="no compiler was at hand when the package was installed")


@given(st.integers(1, 16), st.integers(0, 900), st.booleans(), st.integers(0, 2**31))
@settings(max_examples=25, deadline=None)
def test_planes_have_the_bits_of_torch(neighbors, count, colored, seed):
    generator = torch.Generator().manual_seed(seed)

    def numbers(*shape):
        return torch.rand(*shape, dtype=torch.float64, generator=generator)

    base = tr.Clouds(points=numbers(80, 3), colors=numbers(80, 3) if colored else None)
    base.points[:20] = base.points[20]  # some at one place
    weight = torch.randint(1, 9, (80,), generator=generator).double()
    near = torch.randint(0, 80, (count, neighbors), generator=generator)
    near[: count // 4] = near[: count // 4] % 20
    arguments = numbers(count, 3), base, weight, near
    with native_kernels(False):
        expected = _planes(*arguments)
    before = torch.get_num_threads()
    try:
        for threads in (1, 2, 3):
            torch.set_num_threads(threads)
            assert same_bits(_planes(*arguments), expected)
    finally:
        torch.set_num_threads(before)
