"""Trees and hedges: trunks, boughs, and crowns of clumps of leaves."""

from __future__ import annotations

import numpy as np

from torchreg.synthetic.scene import Array
from torchreg.synthetic.scene.paint import from_hsv, paint
from torchreg.synthetic.scene.quads import Quads, boxes, cylinders, rectangles, up


def broadleaf(rng: np.random.Generator) -> Quads:
    """A trunk that forks into boughs, each with a clump of leaves at its end."""
    tall, reach = rng.uniform(5, 9), rng.uniform(1.4, 2.6)
    fork, boughs = 0.3 * tall, int(rng.integers(7, 12))
    around, rise = rng.uniform(0, 2 * np.pi, boughs), rng.uniform(0.15, 0.95, boughs)
    out = reach * np.sqrt(1 - (2 * rise - 0.9).clip(-0.95, 0.95) ** 2)
    tips = np.stack((out * np.cos(around), out * np.sin(around), fork + 0.3 + rise * 0.65 * tall), axis=1)
    size = rng.uniform(0.28, 0.45, (boughs, 1)) * reach * [1.3, 1.3, 0.9] + 0.25
    bark = from_hsv(rng.uniform(0.05, 0.11, 1), rng.uniform(0.15, 0.45, 1), rng.uniform(0.25, 0.5, 1))
    wood = paint(rng, bark, 0.6 * bark, pattern="patches", scale=0.2)
    thick = rng.uniform(0.12, 0.22)
    return Quads.join(
        [
            cylinders((0, 0, 0), thick, fork + 0.3, wood, sides=14),
            cylinders((0, 0, fork), 0.6 * thick, 0.4 * tall, wood, sides=10),
            _sticks(up(fork) + 0 * tips, tips, 0.5 * thick, rng, bark),
            _leaves(np.repeat(tips, 110, axis=0), np.repeat(size, 110, axis=0), rng, _foliage(rng)),
        ]
    )


def conifer(rng: np.random.Generator) -> Quads:
    """A straight trunk in a cone of needles that starts near the ground."""
    tall, wide, count = rng.uniform(5, 9), rng.uniform(1.1, 1.8), 900
    height = 1 - np.sqrt(rng.random(count))  # most low, where the cone is wide
    around, tier = rng.uniform(0, 2 * np.pi, count), 0.75 + 0.25 * (1 - 9 * height % 1)
    out = wide * (1 - height) * tier * rng.uniform(0.75, 1, count)
    middle = np.stack((out * np.cos(around), out * np.sin(around), 0.5 + height * (tall - 0.5)), axis=1)
    green = from_hsv(rng.uniform(0.3, 0.45, 1), rng.uniform(0.3, 0.6, 1), rng.uniform(0.25, 0.42, 1))
    bark = paint(rng, (0.3, 0.22, 0.17))
    return Quads.join(
        [cylinders((0, 0, 0), 0.14, 0.9 * tall, bark, sides=12), _leaves(middle, np.full((count, 3), 0.06), rng, green)]
    )


def hedge(rng: np.random.Generator, length: float) -> Quads:
    """A clipped hedge of this length in meters along x."""
    tall, wide = rng.uniform(0.7, 1.4), rng.uniform(0.6, 0.9)
    size, count = np.array([length, wide, tall]), int(110 * length)
    place = rng.uniform(-0.5, 0.5, (count, 3))
    axis = rng.choice(3, count, p=[0.1, 0.5, 0.4])
    place[np.arange(count), axis] = np.where(axis == 2, 0.5, np.sign(place[np.arange(count), axis]) * 0.5)
    green = _foliage(rng)
    core = paint(rng, 0.5 * green)
    return Quads.join(
        [
            boxes(up(tall / 2), 0.86 * size, core),
            _leaves(place * size + up(tall / 2), np.full((count, 3), 0.03), rng, green, edge=0.08),
        ]
    )


def _foliage(rng: np.random.Generator) -> Array:
    """A color of leaves, (1, 3): most green, some of autumn, a few dark red."""
    kind = rng.random()
    if kind < 0.7:
        low, high = (0.2, 0.4, 0.3), (0.34, 0.7, 0.55)
    elif kind < 0.9:
        low, high = (0.06, 0.5, 0.5), (0.15, 0.8, 0.75)
    else:
        low, high = (0.95, 0.4, 0.25), (1.0, 0.6, 0.45)
    return from_hsv(*rng.uniform(low, high, (1, 3)).T)


def _leaves(middle: Array, spread: Array, rng: np.random.Generator, color: Array, edge: float = 0.13) -> Quads:
    """Bunches of leaves, one quad each, about places (N, 3) with half axes ``spread`` (N, 3); meters."""
    count = len(middle)
    outward = rng.standard_normal((count, 3))
    outward *= rng.random((count, 1)) ** 0.4 / np.linalg.norm(outward, axis=1, keepdims=True)
    edge_u, edge_v = edge * rng.standard_normal((2, count, 3))
    tones = np.clip(color * rng.uniform(0.75, 1.25, (count, 1)) * rng.uniform(0.9, 1.1, (count, 3)), 0, 1)
    return rectangles(middle + spread * outward, edge_u, edge_v, paint(rng, tones))


def _sticks(start: Array, end: Array, thick: float, rng: np.random.Generator, color: Array) -> Quads:
    """Slanted boughs from ``start`` to ``end`` (N, 3), two crossed strips each."""
    along = end - start
    first = np.cross(along, rng.standard_normal(along.shape))
    first *= thick / np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(along, first)
    second *= thick / np.linalg.norm(second, axis=1, keepdims=True)
    strips = [
        rectangles((start + end) / 2, along, across, paint(rng, color, count=len(start))) for across in (first, second)
    ]
    return Quads.join(strips)
