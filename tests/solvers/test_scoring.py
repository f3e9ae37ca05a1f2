"""One matrix product proposes the counts that elementwise residuals decide."""

import pytest
import torch
from closeness import close
from determinism import THREADS, pieces, same_bits, threads
from problems import random_rotation

from torchreg.solvers.scoring import correspondence_vectors, hypothesis_vectors, propose_counts, residuals


def hypotheses(count, matches, seed=0, dtype=torch.float64):
    """Rotations (3, 3, H), translations (3, H), and correspondences (3, M) twice."""
    generator = torch.Generator().manual_seed(seed)
    rotation = torch.stack([random_rotation(generator) for _ in range(count)], dim=-1)
    numbers = torch.randn(3, count + 2 * matches, dtype=torch.float64, generator=generator)
    translation, source, target = numbers.split([count, matches, matches], dim=1)
    return [values.contiguous().to(dtype) for values in (rotation, translation, source, target)]


def test_residuals_are_squared_distances():
    rotation, translation, source, target = hypotheses(20, 30)
    moved = torch.einsum("ijh,jm->him", rotation, source) + translation.t()[:, :, None]
    assert close(residuals(rotation, translation, source, target), (moved - target).square().sum(dim=1), atol=1e-12)


def test_the_inner_product_is_the_squared_distance():
    rotation, translation, source, target = hypotheses(20, 30)
    product = hypothesis_vectors(rotation, translation) @ correspondence_vectors(source, target)
    square = product + (translation * translation).sum(dim=0)[:, None]
    assert close(square, residuals(rotation, translation, source, target), atol=1e-12)


def assert_close_to_exact(proposed, rotation, translation, source, target, threshold):
    """The counts of the residuals, but for residuals within rounding of the threshold."""
    square = residuals(rotation, translation, source, target).double()
    exact = (square < threshold**2).sum(dim=1)
    doubtful = ((square - threshold**2).abs() < 1e-4).sum(dim=1)
    assert exact.sum() > 0
    assert ((proposed - exact).abs() <= doubtful).all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("threshold", [0.1, 1.0, 3.0])
def test_proposed_counts_are_the_counts_of_residuals(dtype, threshold):
    problem = hypotheses(100, 300, dtype=dtype)
    proposed = propose_counts(*problem[:2], correspondence_vectors(*problem[2:]), threshold)
    assert_close_to_exact(proposed, *problem, threshold)


def test_proposed_counts_hold_for_any_tile_and_threads():
    problem = hypotheses(200, 700, dtype=torch.float32)
    vectors = correspondence_vectors(*problem[2:])
    for number in THREADS:
        for tile in (1, 700 * 7, 1 << 30):
            with threads(number), pieces(1 << 17, tile):
                assert_close_to_exact(propose_counts(*problem[:2], vectors, 0.7), *problem, 0.7)


def test_residuals_have_their_bits_whatever_stands_beside_them():
    rotation, translation, source, target = hypotheses(64, 1001)
    together = residuals(rotation, translation, source, target)
    for rows in (slice(0, 1), slice(3, 17)):
        for columns in (slice(0, 1), slice(5, 700)):
            alone = residuals(
                rotation[..., rows].contiguous(),
                translation[:, rows].contiguous(),
                source[:, columns].contiguous(),
                target[:, columns].contiguous(),
            )
            assert same_bits(alone, together[rows, columns])
    for number in THREADS:
        with threads(number):
            assert same_bits(residuals(rotation, translation, source, target), together)
