"""Colors as buildings and what is in them have: many grays and beiges, some muted tones, few strong ones."""

from __future__ import annotations

import numpy as np

from torchreg.synthetic.scene.arrays import Array


def vivid(rng: np.random.Generator, count: int = 1) -> Array:
    """Strong colors, (count, 3) sRGB."""
    hue, saturation, value = rng.random(count), rng.uniform(0.6, 0.95, count), rng.uniform(0.45, 0.95, count)
    return from_hsv(hue, saturation, value)


def neutral(rng: np.random.Generator, low: float = 0.6, high: float = 0.92, count: int = 1) -> Array:
    """Whites, grays and beiges, (count, 3) sRGB."""
    hue, saturation = rng.uniform(0.05, 0.17, count), 0.25 * rng.random(count) ** 2
    return from_hsv(hue, saturation, rng.uniform(low, high, count))


def muted(rng: np.random.Generator, count: int = 1) -> Array:
    """Colors of walls, carpets and stone that are colored at all, half of them warm; (count, 3) sRGB."""
    hue = np.where(rng.random(count) < 0.5, rng.uniform(0.0, 0.15, count), rng.random(count))
    return from_hsv(hue, rng.uniform(0.2, 0.55, count), rng.uniform(0.4, 0.85, count))


def plain_or_muted(rng: np.random.Generator, share: float) -> Array:
    """One color (1, 3): muted with the probability ``share``, else neutral."""
    return muted(rng) if rng.random() < share else neutral(rng, 0.75, 0.95)


def wares(rng: np.random.Generator, count: int) -> Array:
    """Colors of goods, (count, 3) sRGB: a third of them vivid, the others pale, gray or dark."""
    strong = rng.random((count, 1)) < 0.35
    return np.asarray(np.where(strong, vivid(rng, count), neutral(rng, 0.12, 0.95, count)))


def from_hsv(hue: Array, saturation: Array, value: Array) -> Array:
    """RGB (P, 3) in [0, 1] of hue, saturation and value (P,) in [0, 1]."""
    sector = (hue[:, None] * 6 + np.array([5.0, 3.0, 1.0])) % 6  # (P, 3)
    ramp = np.clip(np.minimum(sector, 4 - sector), 0, 1)
    return np.asarray(value[:, None] * (1 - saturation[:, None] * ramp))
