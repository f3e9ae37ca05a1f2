"""Light and camera: colors stay colors, each option does its own thing, and gradients stay finite."""

import pytest
import torch
from refusals import refuses

import torchreg as tr
from torchreg.augment import Illumination, shift_hue
from torchreg.augment.illumination import apply_gamma, from_linear, to_linear
from torchreg.descriptors.color import hsv

COLORS = torch.rand(200, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
CORNERS = torch.cartesian_prod(*[torch.tensor([0.0, 0.5, 1.0], dtype=torch.float64)] * 3)  # grays among them
NONE = {"white_balance": 0.0, "exposure": 0.0, "gamma": 1.0, "hue": 0.0}


def lit(colors: torch.Tensor, **options) -> torch.Tensor:
    return Illumination(**{**NONE, **options})(tr.Clouds(torch.zeros_like(colors), colors=colors)).colors


@pytest.mark.parametrize("turns", [1.0, -1.0, 0.0, 3.0])
def test_whole_turns_of_hue_change_nothing(turns):
    for colors in (COLORS, CORNERS):
        assert torch.allclose(shift_hue(colors, turns), colors, atol=1e-7)


def test_shifts_of_hue_add_up_and_keep_saturation_and_value():
    shifted = shift_hue(COLORS, 0.2)
    before, after = hsv(COLORS), hsv(shifted)
    assert torch.allclose((after[:, 0] - before[:, 0] - 0.2 + 0.5) % 1 - 0.5, torch.zeros(200).double(), atol=1e-6)
    assert torch.allclose(after[:, 1:], before[:, 1:], atol=1e-6)
    assert torch.allclose(shift_hue(shifted, 0.35), shift_hue(COLORS, 0.55), atol=1e-6)
    assert torch.allclose(shift_hue(COLORS, 1 / 3), COLORS.roll(1, dims=1), atol=1e-6)  # red becomes green
    grays = torch.linspace(0, 1, 5, dtype=torch.float64)[:, None].expand(5, 3)
    assert torch.allclose(shift_hue(grays, 0.4), grays, atol=1e-7)


def test_linear_light_and_back():
    assert torch.allclose(from_linear(to_linear(COLORS)), COLORS, atol=1e-6)
    assert to_linear(torch.tensor([0.0, 0.5, 1.0])).tolist() == pytest.approx([0, 0.2140, 1], abs=1e-4)
    ramp = torch.linspace(0, 1, 2000, dtype=torch.float64)
    for curve in (to_linear, from_linear, lambda x: apply_gamma(x, 0.3), lambda x: apply_gamma(x, 3.0)):
        steps = curve(ramp).diff()
        assert (steps > 0).all()
        assert curve(ramp[[0, -1]]).tolist() == pytest.approx([0, 1], abs=1e-12)


def test_colors_stay_within_bounds_however_strong_the_change():
    for _ in range(5):
        for colors in (COLORS, CORNERS, COLORS.float()):
            changed = lit(colors, white_balance=4, exposure=8, gamma=4, hue=1)
            assert changed.dtype == colors.dtype
            assert changed.min() >= 0
            assert changed.max() <= 1
    assert torch.equal(lit(COLORS), COLORS)


def test_exposure_scales_linear_light_of_all_channels_alike():
    dim = 0.2 * COLORS  # far from white
    ratio = to_linear(lit(dim, exposure=1.0)) / to_linear(dim)
    assert torch.allclose(ratio, ratio[0, 0].expand_as(ratio), rtol=1e-5)
    assert 0.5 <= ratio[0, 0] <= 2
    assert ratio[0, 0] != 1


def test_white_balance_changes_red_and_blue_against_green():
    dim = 0.2 * COLORS
    ratio = to_linear(lit(dim, white_balance=1.0)) / to_linear(dim)
    assert torch.allclose(ratio, ratio[:1].expand_as(ratio), rtol=1e-5)
    red, green, blue = ratio[0].tolist()
    assert green == pytest.approx(1)
    assert abs(red - 1) > 0.01
    assert abs(blue - 1) > 0.01
    assert red != pytest.approx(blue)


def test_gamma_keeps_black_and_white_and_the_order_of_colors():
    ramp = torch.linspace(0, 1, 50, dtype=torch.float64)[:, None].expand(50, 3)
    changed = lit(ramp, gamma=2.0)
    assert changed[0].tolist() == [0, 0, 0]
    assert changed[-1].tolist() == [1, 1, 1]
    assert (changed.diff(dim=0) > 0).all()
    assert (changed - ramp).abs().max() > 0.01


@pytest.mark.parametrize(
    "change", [lambda c: shift_hue(c, 0.13), to_linear, from_linear, lambda c: apply_gamma(c, 0.4)]
)
def test_gradients_are_right_and_finite_at_black_gray_and_white(change):
    inner = (0.1 + 0.8 * COLORS[:20]).requires_grad_()
    assert torch.autograd.gradcheck(change, inner)
    edge = CORNERS.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(change(edge).sum(), edge)
    assert gradient.isfinite().all()


def test_refusals():
    with refuses("hue", "turns in [0, 1]"):
        Illumination(hue=2)
    with refuses("gamma", "number in [1, 4]"):
        Illumination(gamma=0.5)
    with refuses("exposure", "stops in [0, 8]"):
        Illumination(exposure=-1)
    with refuses("white_balance", "a number", "much"):
        Illumination(white_balance="much")
