"""Pages of HTML taken apart, by the parser of Python's own library."""

from __future__ import annotations

import base64
import json
import zlib
from html.parser import HTMLParser

import numpy as np

BLOCK = 4096  # points, as viewer.js has it
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
    """The points (N, 3) of one cloud of a view, as its script places them in a state, in the order of the script."""
    planes = _inflated(cloud["places"]).reshape(3, 2, -1).astype(int)
    steps = (planes[:, 0] + 256 * planes[:, 1]).T  # (N, 3)
    blocks = np.array(cloud["blocks"]).reshape(-1, 4)
    parts = [steps[begin : begin + BLOCK].cumsum(axis=0) % 65536 for begin in range(0, len(steps), BLOCK)]
    places = [low[:3] + low[3] * part for low, part in zip(blocks, parts, strict=True)]
    pose = np.array(cloud["poses"][state])
    return (np.concatenate(places) if places else np.empty((0, 3))) @ pose[:3, :3].T + pose[:3, 3]


def drawn_bytes(cloud, name):
    """The colors (N, 3) or the scalars (N,) of one cloud of a view, from 0 to 255, likewise."""
    planes = _inflated(cloud[name]).reshape(-1, cloud["count"]).T.astype(int)
    parts = [planes[begin : begin + BLOCK].cumsum(axis=0) % 256 for begin in range(0, len(planes), BLOCK)]
    values = np.concatenate(parts)
    return values if name == "colors" else values[:, 0]


def _inflated(text):
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), dtype=np.uint8)
