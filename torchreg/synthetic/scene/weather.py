"""Light between a cloudy and a sunny day, indoors and in the open."""

from __future__ import annotations

import numpy as np

from torchreg.synthetic.scene import Array
from torchreg.synthetic.scene.light import Light


def indoor_light(
    lamps: Array,
    lamp_power: Array,
    sky_center: Array,
    sky_area: float,
    weather: float,
    rng: np.random.Generator,
) -> Light:
    """Lamps, and daylight through a window in the ceiling.

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
