"""Light on surfaces, and the camera that turns it into 8-bit colors.

Irradiance is the sum of an even ambient part, of lamps, of a window to the sky in the ceiling, and of the sun.
Its unit is arbitrary: 1 is a well-lit floor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from torchreg.datasets.scene.arrays import Array

DISPLAY_GAMMA = 2.2


@dataclass(frozen=True, eq=False, kw_only=True)
class Light:
    """All light of a scene at one moment. Colors are linear RGB.

    Attributes:
        ambient: (3,) light from all sides, after many reflections.
        lamps: (M, 3) meters, in the frame of the scene.
        lamp_power: (M, 3) irradiance at one meter under the lamp.
        sky_center: (3,) meters, the middle of the skylight.
        sky_power: (3,) irradiance at one meter under it, were it a point.
        sun_direction: (3,) unit vector from the scene to the sun.
        sun: (3,) irradiance of a surface that faces the sun.
    """

    ambient: Array
    lamps: Array
    lamp_power: Array
    sky_center: Array
    sky_power: Array
    sun_direction: Array
    sun: Array


@dataclass(frozen=True, eq=False, kw_only=True)
class Camera:
    """What one scan's camera does to the light that reaches it.

    Attributes:
        gain: from radiance to the range [0, 1] of the sensor.
        white_balance: (3,) factor on each channel.
        gamma: the colors are the signal to the power of ``1 / gamma``.
        noise: standard deviation in the colors, of the range [0, 1].
    """

    gain: float
    white_balance: Array
    gamma: float = DISPLAY_GAMMA
    noise: float = 0.012


class Sight(Protocol):
    """What stands in the way of light."""

    def reaches(self, points: Array, goals: Array) -> Array:
        """Whether nothing stands between the points (P, 3) and their goals, (3,) or (P, 3); (P,) bool."""

    def escapes(self, points: Array, way: Array) -> Array:
        """Whether nothing stands in the direction ``way`` (3,) of the points (P, 3); (P,) bool."""


def irradiance(points: Array, normals: Array, light: Light, sight: Sight) -> Array:
    """The light that falls on surfaces; the sun, the sky and the strongest lamp at each point cast shadows.

    Args:
        points: (P, 3) meters, in the frame of the scene.
        normals: (P, 3) of unit length, on the visible side.
        light: the lamps, the sky and the sun.
        sight: the scene, for the shadows.

    Returns:
        (P, 3) float64, linear RGB.
    """
    # Floors and what faces the lamps pass light on upwards; walls get the mean.
    total = light.ambient * (1 + 0.15 * normals[:, 2:])
    brightness = light.lamp_power.mean(axis=1)
    strongest, which = np.zeros(len(points)), np.zeros(len(points), dtype=np.int64)
    for k, (position, power) in enumerate(zip(light.lamps, light.lamp_power, strict=True)):
        share = _from_above(points, normals, position)
        total += share[:, None] * power
        which[share * brightness[k] > strongest] = k
        np.maximum(strongest, share * brightness[k], out=strongest)
    shaded = ~sight.reaches(points, light.lamps[which])
    total -= (0.8 * shaded * strongest / brightness[which])[:, None] * light.lamp_power[which]
    sky = _from_above(points, normals, light.sky_center) * sight.reaches(points, light.sky_center)
    sun = np.clip(normals @ light.sun_direction, 0, 1) * sight.escapes(points, light.sun_direction)
    return np.asarray(total + sky[:, None] * light.sky_power + sun[:, None] * light.sun)


def develop(radiance: Array, camera: Camera, rng: np.random.Generator) -> Array:
    """The colors (P, 3) uint8 that a camera records of the radiance (P, 3)."""
    signal = camera.gain * camera.white_balance * radiance
    signal = np.where(signal > 0.7, 0.7 + 0.3 * np.tanh((signal - 0.7) / 0.6), signal)  # bright parts bleach
    colors = np.clip(signal, 0, 1) ** (1 / camera.gamma)
    colors += camera.noise * rng.standard_normal(colors.shape)
    return np.asarray(np.rint(255 * np.clip(colors, 0, 1)).astype(np.uint8))


def linear(color: Array) -> Array:
    """Linear RGB of sRGB colors in [0, 1], by the plain power law."""
    return np.asarray(color**DISPLAY_GAMMA)


def _from_above(points: Array, normals: Array, position: Array) -> Array:
    """Light from a panel that faces down, (P,): inverse square, and the cosine at both ends.

    A panel has a size, so that nothing near it is infinitely bright.
    """
    way = position - points
    square = np.einsum("pi,pi->p", way, way)
    facing, sent = np.clip(np.einsum("pi,pi->p", way, normals), 0, None), np.clip(way[:, 2], 0, None)
    return np.asarray(facing * sent / (square * (square + 0.3)))
