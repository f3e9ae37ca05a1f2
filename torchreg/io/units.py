"""Units of length that clouds come in."""

from __future__ import annotations

from torchreg.errors import one_of

METERS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048, "us-ft": 1200 / 3937}
"""Meters of each unit; "us-ft" is the foot of the United States' surveys."""

UNITS = (*METERS, "file")
"""What ``units`` may be: a unit, or the one that the file names."""


def checked_units(units: str | None) -> str | None:
    """Return ``units`` if it is ``None`` or one of ``UNITS``, else raise ``ValueError``."""
    return None if units is None else one_of(units, "units", UNITS)


def meters_of(units: str | None, in_file: str | None) -> float:
    """Meters of the unit of a file: as the caller says, or as the file does where "file" is asked for; else 1."""
    if units == "file":
        return METERS.get(in_file or "m", 1.0)
    return METERS[units] if units is not None else 1.0


def unit_note(units: str | None, in_file: str | None) -> tuple[str, ...]:
    """What a user should know of the unit."""
    if units == "file" and in_file is None:
        return ("the file does not say its unit: its numbers are taken for meters",)
    if units is None and in_file not in (None, "m"):
        return (f"the file says that its unit is {in_file}; its numbers are kept: units='file' makes them meters",)
    if units not in (None, "file") and in_file not in (None, units):
        return (f"read in {units}, as asked for; the file says that its unit is {in_file}",)
    return ()
