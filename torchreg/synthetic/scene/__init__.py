"""Parts of every simulated place: painted quads, light, a laser scanner, and the simulation that combines them."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

Array = npt.NDArray[Any]
