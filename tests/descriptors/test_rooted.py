"""Square roots of histograms."""

from dataclasses import replace

import pytest
import torch
from closeness import close
from problems import room_pair
from refusals import refuses
from torch.autograd import gradcheck

import torchreg as tr
from torchreg.descriptors.fuse import rooted


def percents(*shape):
    return 100 * torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0))


def test_no_share_leaves_histograms_and_a_whole_one_takes_roots():
    values = percents(20, 33)
    assert torch.equal(rooted(values, 0.0), values)
    assert close(rooted(values, 1.0), 10 * values.sqrt(), atol=1.1)
    assert rooted(torch.zeros(3, 4), 0.7).abs().max() < 1e-6


def test_entries_keep_their_order():
    values = percents(500).sort().values
    for share in (0.2, 0.5, 1.0):
        assert rooted(values, share).diff().min() > 0


def test_gradients_are_true_and_finite_at_zero():
    values = torch.cat([percents(5), torch.zeros(2, dtype=torch.float64)])
    share = torch.tensor(0.4, dtype=torch.float64, requires_grad=True)
    assert gradcheck(rooted, (percents(5).requires_grad_(), share))
    values.requires_grad_()
    (grad,) = torch.autograd.grad(rooted(values, 1.0).sum(), values)
    assert torch.isfinite(grad).all()


def test_the_option_changes_the_matches_and_repeats_bit_for_bit():
    room = room_pair(600)
    (plain,) = tr.derive_options(room.source, room.target)
    without = replace(plain, effort="plain")
    rooted_options = replace(without, root=1.0)
    one, other, again = (
        tr.register(room.source, room.target, chosen).correspondences
        for chosen in (without, rooted_options, rooted_options)
    )
    assert torch.equal(other.source, again.source)
    assert not (len(one.source) == len(other.source) and torch.equal(one.target, other.target))


@pytest.mark.parametrize("root", [-0.1, 1.1, float("nan")])
def test_a_root_out_of_range_is_refused(root):
    with refuses("root", "[0, 1]"):
        tr.RegistrationOptions(root=root)
