"""Light between a cloudy and a sunny day, in a hall and in the open, and how a camera is set for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from torchreg.synthetic.scene.arrays import Array
from torchreg.synthetic.scene.light import DISPLAY_GAMMA, Camera, Light, irradiance


def hall_light(
    lamps: Array,
    lamp_power: Array,
    sky_center: Array,
    sky_area: float,
    weather: float,
    rng: np.random.Generator,
) -> Light:
    """Lamps and daylight.

    On a sunny day the sun falls through the skylight, the sky sends more light, and the lamps are dimmed; on
    a cloudy day the sky is weaker and bluer, and the lamps are up.

    Args:
        lamps: (M, 3) meters.
        lamp_power: (M,) irradiance at one meter under each lamp on a day between sunny and cloudy.
        sky_center: (3,) meters, the middle of the skylight.
        sky_area: square meters of the skylight.
        weather: 1 is a sunny day, -1 a cloudy one.
        rng: draws the tint of each lamp and where the sun stands; the same draws whatever the weather.
    """
    tint = np.array([1.0, 0.92, 0.8]) * np.exp(0.06 * rng.standard_normal((len(lamps), 3)))
    azimuth = rng.uniform(0, 2 * np.pi) + 0.4 * weather
    elevation = np.deg2rad(rng.uniform(50, 65) + 5 * weather)
    flat, bright = np.cos(elevation), max(0.0, 0.5 + 0.5 * weather)
    blue = np.array([0.95 + 0.05 * weather, 1.0, 1.1 - 0.06 * weather])
    return Light(
        ambient=np.array([0.3, 0.29, 0.27]) + 0.1 * bright,
        lamps=lamps,
        lamp_power=lamp_power[:, None] * tint * 2 ** (-0.4 * weather),
        sky_center=sky_center,
        sky_power=0.22 * sky_area * 2 ** (0.5 * weather) * blue,
        sun_direction=np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)]),
        sun=2.0 * bright * np.array([1.0, 0.95, 0.86]),
    )


def daylight(weather: float, rng: np.random.Generator) -> Light:
    """Light in the open.

    On a sunny day the sun casts sharp shadows, and a blue sky lights what lies in them; on a cloudy day an even gray
    sky is all.

    Args:
        weather: 1 is a sunny day, -1 a cloudy one.
        rng: draws where the sun stands; the same draws whatever the weather.
    """
    azimuth = rng.uniform(0, 2 * np.pi) + 0.4 * weather
    elevation = np.deg2rad(rng.uniform(35, 60) + 5 * weather)
    flat, bright = np.cos(elevation), max(0.0, 0.5 + 0.5 * weather)
    blue = np.array([0.9 - 0.14 * weather, 1.0, 1.14 + 0.16 * weather])
    return Light(
        ambient=(0.12 + 0.1 * bright) * np.array([1.0, 0.98, 0.9]),
        sun_direction=np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)]),
        sun=2.2 * bright * np.array([1.0, 0.94, 0.84]),
        dome=0.8 * 2 ** (-0.3 * weather) * blue,
    )


def exposed_camera(
    light: Light, probes: Array, relight: float, rng: np.random.Generator, sunlit: float = 0.1
) -> Camera:
    """A camera whose exposure and white balance follow the light, with errors of its own.

    Args:
        light: what it is exposed for.
        probes: (P, 3) meters, where the light is metered, facing up.
        relight: the size of the errors in exposure, white balance and gamma; 0 makes all cameras in one
            light alike.
        rng: the same draws whatever ``relight``.
        sunlit: the share of the sun's light that counts, as little is sunlit in a hall.
    """
    up = np.broadcast_to((0.0, 0.0, 1.0), probes.shape)
    sunless = replace(light, sun=np.zeros(3))
    metered = irradiance(probes, up, sunless, _Unhindered()).mean(axis=0) + sunlit * light.sun  # (3,)
    exposure, gamma = np.exp(relight * np.array([0.15, 0.06]) * rng.standard_normal(2))
    balance = (metered.mean() / metered) ** 0.7  # cameras leave some of the tint
    return Camera(
        gain=float(1.1 * exposure / metered.mean()),
        white_balance=balance * np.exp(0.05 * relight * rng.standard_normal(3)),
        gamma=float(DISPLAY_GAMMA * gamma),
    )


class _Unhindered:
    """Every lamp and all of the sky are seen."""

    def reaches(self, points: Array, goals: Array) -> Array:
        return np.ones(len(points), dtype=bool)

    def escapes(self, points: Array, way: Array) -> Array:
        return np.ones(len(points), dtype=bool)
