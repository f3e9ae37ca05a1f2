"""Light on surfaces, between a cloudy and a sunny day, and the camera that turns it into 8-bit colors.

Irradiance is the sum of an even ambient part, of lamps, of a window to the sky in the ceiling, of the open sky and of
the sun. Its unit is arbitrary: 1 is a well-lit floor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from torchreg.synthetic.scene import Array

DISPLAY_GAMMA = 2.2


@dataclass(frozen=True, eq=False, kw_only=True)
class Light:
    """All light of a scene at one moment; colors are linear RGB, and a source left out gives none.

    The open sky is equally bright in all directions.
    """

    ambient: Array  # (3,) light from all sides, after many reflections
    sun_direction: Array  # (3,) unit vector from the scene to the sun
    sun: Array  # (3,) irradiance of a surface that faces the sun
    lamps: Array = field(default_factory=lambda: np.zeros((0, 3)))  # (M, 3) meters, in the frame of the scene
    lamp_power: Array = field(default_factory=lambda: np.zeros((0, 3)))  # (M, 3) irradiance 1 m under the lamp
    near_lamps: Callable[[Array], Array] | None = None  # indices (P, K) of the lamps that light points (P, 3); else all
    sky_center: Array = field(default_factory=lambda: np.zeros(3))  # (3,) meters, the middle of the skylight
    sky_power: Array = field(default_factory=lambda: np.zeros(3))  # (3,) irradiance 1 m under it, were it a point
    dome: Array = field(default_factory=lambda: np.zeros(3))  # (3,) irradiance of level ground under the sky


@dataclass(frozen=True, eq=False, kw_only=True)
class Camera:
    """How the camera of one scan records light."""

    gain: float  # from radiance to the range [0, 1] of the sensor
    white_balance: Array  # (3,) factor on each channel
    gamma: float = DISPLAY_GAMMA  # the colors are the signal to the power of 1 / gamma
    noise: float = 0.012  # standard deviation in the colors, of the range [0, 1]


class LineOfSight(Protocol):
    """Visibility between places of a scene."""

    def reaches(self, points: Array, goals: Array) -> Array:
        """Whether nothing lies between the points (P, 3) and their goals, (3,) or (P, 3); (P,) bool."""

    def escapes(self, points: Array, direction: Array) -> Array:
        """Whether nothing lies in the direction ``direction`` (3,) of the points (P, 3); (P,) bool."""


def indoor_light(
    lamps: Array, lamp_power: Array, sky_center: Array, sky_area: float, weather: float, rng: np.random.Generator
) -> Light:
    """Lamps, and daylight through a window in the ceiling.

    On a sunny day (``weather`` 1) the sun falls through the skylight, the sky sends more light, and the lamps are
    dimmed; on a cloudy day (-1) the sky is weaker and bluer, and the lamps are up. ``lamp_power`` (M,) is the
    irradiance at one meter under each of the ``lamps`` (M, 3), meters, on a day in between; the skylight has
    ``sky_area`` square meters about its middle ``sky_center`` (3,), meters. ``rng`` draws the tint of each lamp and
    where the sun stands; the same draws whatever the weather.
    """
    tint = np.array([1.0, 0.92, 0.8]) * np.exp(0.06 * rng.standard_normal((len(lamps), 3)))
    bright = max(0.0, 0.5 + 0.5 * weather)
    blue = np.array([0.95 + 0.05 * weather, 1.0, 1.1 - 0.06 * weather])
    return Light(
        ambient=np.array([0.3, 0.29, 0.27]) + 0.1 * bright,
        lamps=lamps,
        lamp_power=lamp_power[:, None] * tint * 2 ** (-0.4 * weather),
        sky_center=sky_center,
        sky_power=0.22 * sky_area * 2 ** (0.5 * weather) * blue,
        sun_direction=_sun_direction(50, 65, weather, rng),
        sun=2.0 * bright * np.array([1.0, 0.95, 0.86]),
    )


def daylight(weather: float, rng: np.random.Generator) -> Light:
    """Light in the open; arguments as for ``indoor_light``.

    On a sunny day the sun casts sharp shadows, and a blue sky lights them; on a cloudy day all light comes from an
    even gray sky.
    """
    bright = max(0.0, 0.5 + 0.5 * weather)
    blue = np.array([0.9 - 0.14 * weather, 1.0, 1.14 + 0.16 * weather])
    return Light(
        ambient=(0.12 + 0.1 * bright) * np.array([1.0, 0.98, 0.9]),
        sun_direction=_sun_direction(35, 60, weather, rng),
        sun=2.2 * bright * np.array([1.0, 0.94, 0.84]),
        dome=0.8 * 2 ** (-0.3 * weather) * blue,
    )


def irradiance(points: Array, normals: Array, light: Light, visibility: LineOfSight) -> Array:
    """The light (P, 3), float64 linear RGB, that falls on surfaces at points (P, 3), meters in the frame of the scene.

    The normals (P, 3), of unit length, are on the visible side. The sun, both skies and the strongest lamp at each
    point cast shadows; where a light names the lamps near a point, all of them do.
    """
    # Floors and what faces the lamps pass light on upwards; walls get the mean.
    total = light.ambient * (1 + 0.15 * normals[:, 2:])
    if light.near_lamps is not None:
        _add_near_lamps(total, points, normals, light, light.near_lamps(points), visibility)
    elif len(light.lamps):
        _add_lamps(total, points, normals, light, visibility)
    if light.sky_power.any():
        sky = _from_above(points, normals, light.sky_center) * visibility.reaches(points, light.sky_center)
        total += sky[:, None] * light.sky_power
    if light.dome.any():
        total += _open_sky(points, normals, visibility)[:, None] * light.dome
    sun = np.clip(normals @ light.sun_direction, 0, 1) * visibility.escapes(points, light.sun_direction)
    return np.asarray(total + sun[:, None] * light.sun)


def exposed_camera(light: Light, probes: Array, relight: float, rng: np.random.Generator, *, sunlit: float) -> Camera:
    """A camera set for the light, with errors of its own in exposure, white balance and gamma.

    The light is metered at ``probes`` (P, 3), meters, facing up, with the share ``sunlit`` of the sun's: little of a
    hall is sunlit. ``relight`` is the size of the errors; 0 makes all cameras in one light alike. ``rng`` makes the
    same draws whatever it is.
    """
    up = np.broadcast_to((0.0, 0.0, 1.0), probes.shape)
    sunless = replace(light, sun=np.zeros(3))
    metered = irradiance(probes, up, sunless, _EmptyScene()).mean(axis=0) + sunlit * light.sun  # (3,)
    exposure, gamma = np.exp(relight * np.array([0.15, 0.06]) * rng.standard_normal(2))
    balance = (metered.mean() / metered) ** 0.7  # cameras leave some of the tint
    return Camera(
        gain=float(1.1 * exposure / metered.mean()),
        white_balance=balance * np.exp(0.05 * relight * rng.standard_normal(3)),
        gamma=float(DISPLAY_GAMMA * gamma),
    )


def develop(radiance: Array, camera: Camera, rng: np.random.Generator) -> Array:
    """The colors (P, 3) uint8 that a camera records of the radiance (P, 3)."""
    signal = camera.gain * camera.white_balance * radiance
    signal = np.where(signal > 0.7, 0.7 + 0.3 * np.tanh((signal - 0.7) / 0.6), signal)  # bright parts saturate
    colors = np.clip(signal, 0, 1) ** (1 / camera.gamma)
    colors += camera.noise * rng.standard_normal(colors.shape)
    return np.asarray(np.rint(255 * np.clip(colors, 0, 1)).astype(np.uint8))


def linear(color: Array) -> Array:
    """Linear RGB of sRGB colors in [0, 1], by the plain power law."""
    return np.asarray(color**DISPLAY_GAMMA)


def _sun_direction(low: float, high: float, weather: float, rng: np.random.Generator) -> Array:
    """The unit vector (3,) to the sun, which stands between ``low`` and ``high`` degrees above the horizon."""
    azimuth = rng.uniform(0, 2 * np.pi) + 0.4 * weather
    elevation = np.deg2rad(rng.uniform(low, high) + 5 * weather)
    flat = np.cos(elevation)
    return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


def _add_lamps(total: Array, points: Array, normals: Array, light: Light, visibility: LineOfSight) -> None:
    brightness = light.lamp_power.mean(axis=1)
    strongest, which = np.zeros(len(points)), np.zeros(len(points), dtype=np.int64)
    for k, (position, power) in enumerate(zip(light.lamps, light.lamp_power, strict=True)):
        share = _from_above(points, normals, position)
        total += share[:, None] * power
        which[share * brightness[k] > strongest] = k
        np.maximum(strongest, share * brightness[k], out=strongest)
    shaded = ~visibility.reaches(points, light.lamps[which])
    total -= (0.8 * shaded * strongest / brightness[which])[:, None] * light.lamp_power[which]


def _add_near_lamps(
    total: Array, points: Array, normals: Array, light: Light, near: Array, visibility: LineOfSight
) -> None:
    for which in near.T:
        goals = light.lamps[which]
        share = _from_above(points, normals, goals)
        rows = np.flatnonzero(share > 1e-3)
        rows = rows[visibility.reaches(points[rows], goals[rows])]
        total[rows] += share[rows, None] * light.lamp_power[which[rows]]


def _from_above(points: Array, normals: Array, position: Array) -> Array:
    """Light from a panel that faces down at ``position``, (3,) or (P, 3): inverse square, and the cosine at both ends.

    Of shape (P,). A panel has a size, so that nothing near it is infinitely bright.
    """
    offset = position - points
    square = np.einsum("pi,pi->p", offset, offset)
    facing, sent = np.clip(np.einsum("pi,pi->p", offset, normals), 0, None), np.clip(offset[:, 2], 0, None)
    return np.asarray(facing * sent / (square * (square + 0.3)))


def _open_sky(points: Array, normals: Array, visibility: LineOfSight) -> Array:
    """The part of an even sky's light that reaches surfaces, (P,); 1 on level ground in the open."""
    total = np.zeros(len(points))
    for direction in _SKY_DIRECTIONS:
        facing = normals @ direction
        rows = np.flatnonzero(facing > 0)
        total[rows] += facing[rows] * visibility.escapes(points[rows], direction)
    return np.asarray(total / _SKY_DIRECTIONS[:, 2].sum())


def _spread_over_sky(count: int) -> Array:
    """Unit vectors (count, 3) spread evenly over the upper hemisphere, on a golden spiral."""
    height = (np.arange(count) + 0.5) / count
    around = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    flat = np.sqrt(1 - height**2)
    return np.stack((flat * np.cos(around), flat * np.sin(around), height), axis=1)


class _EmptyScene:
    """LineOfSight of an empty scene."""

    def reaches(self, points: Array, goals: Array) -> Array:
        return np.ones(len(points), dtype=bool)

    def escapes(self, points: Array, direction: Array) -> Array:
        return np.ones(len(points), dtype=bool)


_SKY_DIRECTIONS = _spread_over_sky(14)
