"""What every simulated place shares: painted quads, light, a scanner, and the order in which they come together."""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

Array = npt.NDArray[Any]
