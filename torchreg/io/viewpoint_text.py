"""A scanner's position as people write it."""

from __future__ import annotations

from torchreg.errors import expect


def viewpoint_of_text(text: str, name: str = "viewpoint") -> str | tuple[float, ...] | None:
    """What ``read_cloud`` takes as ``viewpoint``, from ``auto``, ``origin``, ``none`` or ``x,y,z`` in meters.

    Raises:
        ValueError: anything else; the message calls it by ``name``.
    """
    if text in ("auto", "origin"):
        return text
    if text == "none":
        return None
    try:
        position = tuple(float(word) for word in text.split(","))
    except ValueError:
        position = ()
    expect(len(position) == 3, name, "auto, origin, none or three numbers x,y,z in meters", text)
    return position
