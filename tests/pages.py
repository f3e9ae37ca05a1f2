"""Pages of HTML taken apart, by the parser of Python's own library."""

from __future__ import annotations

import base64
import json
from html.parser import HTMLParser

import numpy as np

_VOID = {"meta", "img", "input", "br", "link", "hr"}


class Page(HTMLParser):
    """The elements of a page; every one that is opened must be closed in turn."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []  # the innermost element, and text in it
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        assert len({name for name, _ in attrs}) == len(attrs), tag
        self.elements.append((tag, dict(attrs)))
        if tag not in _VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if data.strip():
            self.texts.append((self.open[-1] if self.open else "", data))

    def all(self, tag):
        """The attributes of every element of a kind."""
        return [attributes for name, attributes in self.elements if name == tag]

    def text(self, *tags):
        """All text in elements of these kinds, or in all that are read by people."""
        return "\n".join(
            text for tag, text in self.texts if (tag in tags if tags else tag not in ("script", "style", "title"))
        )

    def scenes(self):
        """The data of every 3D view."""
        blocks = [text for tag, text in self.texts if tag == "script" and text.lstrip().startswith("{")]
        return [json.loads(block) for block in blocks]


def drawn_points(cloud, state):
    """The points (N, 3) of one cloud of a view, as its script places them in a state."""
    places = np.frombuffer(base64.b64decode(cloud["positions"]), dtype="<u2").reshape(-1, 3)
    pose = np.array(cloud["poses"][state])
    points = np.array(cloud["low"]) + np.array(cloud["step"]) * places
    return points @ pose[:3, :3].T + pose[:3, 3]


def drawn_bytes(cloud, name):
    """The colors (N, 3) or the scalars (N,) of one cloud of a view, from 0 to 255."""
    values = np.frombuffer(base64.b64decode(cloud[name]), dtype=np.uint8)
    return values.reshape(-1, 3) if name == "colors" else values
