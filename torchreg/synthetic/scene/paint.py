"""Looks of surfaces: random colors, in patterns over the texture coordinates of each quad.

Colors are those of buildings and their contents: many grays and beiges, some muted tones, few strong ones. Texture
coordinates are meters on the surface, (0, 0) in the middle of a quad. A pattern needs no image: the color of each of
its cells follows from an integer hash of the cell and of the surface's key.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from torchreg.synthetic.scene import Array


@dataclass(frozen=True, eq=False)
class Paint:
    """The look of ``Q`` surfaces, one row each."""

    pattern: Array  # (Q,) int64, index of the name among _PATTERNS
    color: Array  # (Q, 3) sRGB in [0, 1], the color of most of the surface
    accent: Array  # (Q, 3) sRGB in [0, 1], the second color of the pattern
    scale: Array  # (Q,) meters, the size of a tile, letter, plank, good or block
    glow: Array  # (Q,) light the surface sends out itself, 1 being the illuminance of a well-lit floor
    key: Array  # (Q,) int64, tells surfaces of equal pattern apart

    def __len__(self) -> int:
        """The number of surfaces."""
        return len(self.pattern)

    def take(self, index: Array) -> Paint:
        """The rows ``index`` (P,) of this paint."""
        return Paint(*(getattr(self, field.name)[index] for field in fields(self)))

    @staticmethod
    def join(parts: Sequence[Paint]) -> Paint:
        """The rows of all parts, one after another."""
        return Paint(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Paint)))


def paint(
    rng: np.random.Generator,
    color: npt.ArrayLike,
    accent: npt.ArrayLike | None = None,
    *,
    count: int | None = None,
    pattern: str = "plain",
    scale: float = 0.5,
    glow: float = 0.0,
) -> Paint:
    """Paint for ``count`` surfaces, each with a key of its own that ``rng`` draws.

    ``color`` is sRGB, (3,) for all surfaces or (Q, 3), and ``count`` by default the number of its rows; the pattern's
    second color, ``accent``, likewise, by default a darker shade. ``pattern``, a name in ``_PATTERNS``, ``scale`` and
    ``glow`` (see ``Paint``) are of all surfaces.
    """
    color = np.atleast_2d(np.asarray(color, dtype=np.float64))
    count = len(color) if count is None else count
    accent = 0.85 * color if accent is None else np.asarray(accent, dtype=np.float64)
    return Paint(
        pattern=np.full(count, list(_PATTERNS).index(pattern)),
        color=np.broadcast_to(color, (count, 3)),
        accent=np.broadcast_to(accent, (count, 3)),
        scale=np.full(count, scale),
        glow=np.full(count, glow),
        key=rng.integers(1 << 30, size=count),
    )


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


def albedo(paint: Paint, uv: Array) -> Array:
    """The color (P, 3), float64 sRGB in [0, 1], of P rows of ``paint``, each at a point ``uv`` (P, 2) on it, meters."""
    color = paint.color.copy()
    for pattern, draw in enumerate(_PATTERNS.values()):
        rows = np.flatnonzero(paint.pattern == pattern)
        if draw is not None and len(rows):
            color[rows] = draw(paint.take(rows), uv[rows])
    # No real surface is of one color: stains as wide as a step, and grain.
    u, v = uv[:, 0], uv[:, 1]
    phase = paint.key % 628 / 100
    stain = 0.03 * np.sin(1.7 * u + phase) * np.sin(2.3 * v + 2 * phase)
    grain = 0.04 * (_hash(_cell(u, 0.02), _cell(v, 0.02), paint.key) - 0.5)
    return np.clip(color * (1 + stain + grain)[:, None], 0, 1)


def _cell(x: Array, size: Array | float) -> Array:
    return np.floor(x / size).astype(np.int64)


def _hash(i: Array, j: Array, key: Array) -> Array:
    """Pseudo-random numbers (P,) in [0, 1) from a cell's two indices and a key."""
    word = (i * 0x9E3779B1 ^ j * 0x85EBCA77 ^ key * 0xC2B2AE3D).astype(np.uint32)
    word = (word ^ word >> 15) * np.uint32(0x2C1B3C6D)
    word = (word ^ word >> 12) * np.uint32(0x297A2D39)
    return np.asarray((word ^ word >> 15) / 2.0**32)


def _choose(where: Array, yes: Array, no: Array) -> Array:
    return np.asarray(np.where(where[:, None], yes, no))


def _tiles(paint: Paint, uv: Array) -> Array:
    i, j = _cell(uv[:, 0], paint.scale), _cell(uv[:, 1], paint.scale)
    tile = _choose((i + j) % 2 == 0, paint.color, paint.accent) * (0.94 + 0.12 * _hash(i, j, paint.key))[:, None]
    return _choose(_on_joint(paint, uv, 0.008), 0.5 * paint.color, tile)


def _panels(paint: Paint, uv: Array) -> Array:
    return _choose(_on_joint(paint, uv, 0.015), paint.accent, paint.color)


def _on_joint(paint: Paint, uv: Array, width: float) -> Array:
    return np.asarray((uv % paint.scale[:, None] < width).any(axis=1))


def _stripes(paint: Paint, uv: Array) -> Array:
    return _choose(_cell(uv[:, 1], paint.scale) % 2 == 0, paint.color, paint.accent)


def _planks(paint: Paint, uv: Array) -> Array:
    plank = _cell(uv[:, 1], paint.scale)
    shift = 5 * paint.scale * _hash(plank, plank, paint.key)
    tone = 0.75 + 0.4 * _hash(_cell(uv[:, 0] + shift, 9 * paint.scale), plank, paint.key)
    return np.asarray(paint.color * tone[:, None])


def _letters(paint: Paint, uv: Array) -> Array:
    """One line of letters along the middle; each is a random 3 x 5 bitmap with a gap behind it."""
    dot = paint.scale / 5
    i, j = _cell(uv[:, 0], dot), _cell(uv[:, 1] + paint.scale / 2, dot)
    inked = (i % 4 < 3) & (j >= 0) & (j < 5) & (_hash(i, j, paint.key) < 0.65)
    return _choose(inked, paint.accent, paint.color)


def _goods(paint: Paint, uv: Array) -> Array:
    """Packages side by side, each of its own color with a paler label."""
    size = np.stack((paint.scale, 1.4 * paint.scale), axis=1)
    i, j = _cell(uv[:, 0], size[:, 0]), _cell(uv[:, 1], size[:, 1])
    hue, saturation, value = (_hash(i, j, paint.key + shift) for shift in (1, 2, 3))
    package = from_hsv(hue, 0.9 * saturation, 0.3 + 0.65 * value)
    label = (np.abs(uv / size % 1 - 0.5) < 0.25).all(axis=1)
    return _choose(label, 0.5 + 0.5 * package, package)


def _poster(paint: Paint, uv: Array) -> Array:
    """Blocks of four tones with soft shading, as a large photograph has them from far."""
    i, j = _cell(uv[:, 0] + 0.4 * uv[:, 1], paint.scale), _cell(uv[:, 1], 0.7 * paint.scale)
    which = (4 * _hash(i, j, paint.key)).astype(np.int64)
    tones = (paint.color, paint.accent, 0.5 * paint.color, 0.5 + 0.5 * paint.accent)
    block = np.stack(tones, axis=1)[np.arange(len(which)), which]  # (P, 3)
    return np.asarray(block * (0.75 + 0.25 * (uv[:, :1] / paint.scale[:, None] % 1)))


def _bricks(paint: Paint, uv: Array) -> Array:
    """Courses of bricks three times as long as high, each of its own tone, with joints of the accent."""
    course = _cell(uv[:, 1], paint.scale)
    u = uv[:, 0] + 1.5 * paint.scale * (course % 2)
    tone = 0.85 + 0.3 * _hash(_cell(u, 3 * paint.scale), course, paint.key)
    joint = (u % (3 * paint.scale) < 0.012) | (uv[:, 1] % paint.scale < 0.012)
    return _choose(joint, paint.accent, paint.color * tone[:, None])


def _patches(paint: Paint, uv: Array) -> Array:
    """Both colors run into each other in patches of several sizes, as in a lawn or in worn asphalt."""
    weight = np.zeros(len(uv))
    for octave, share in enumerate((0.5, 0.3, 0.2)):
        size = paint.scale / 2**octave
        x, y = uv[:, 0] / size, uv[:, 1] / size
        i, j = _cell(x, 1.0), _cell(y, 1.0)
        s, t = (3 * r**2 - 2 * r**3 for r in (x - i, y - j))
        near, far = ((1 - s) * _hash(i, j + k, paint.key) + s * _hash(i + 1, j + k, paint.key) for k in (0, 1))
        weight += share * ((1 - t) * near + t * far)
    return np.asarray(paint.color + weight[:, None] * (paint.accent - paint.color))


_PATTERNS: dict[str, Callable[[Paint, Array], Array] | None] = {
    "plain": None,
    "tiles": _tiles,
    "panels": _panels,
    "stripes": _stripes,
    "planks": _planks,
    "letters": _letters,
    "goods": _goods,
    "poster": _poster,
    "bricks": _bricks,
    "patches": _patches,
}
