"""Tables go into README.md between two comments, so that no figure there is typed by hand."""

from __future__ import annotations

from common import ROOT


def put_into_readme(name: str, text: str) -> None:
    """Replace what stands between ``<!-- begin: NAME -->`` and ``<!-- end: NAME -->``."""
    path = ROOT / "README.md"
    content = path.read_text()
    begin, end = f"<!-- begin: {name} -->", f"<!-- end: {name} -->"
    if content.count(begin) != 1 or content.count(end) != 1:
        raise SystemExit(f"README.md: expected one {begin} and one {end}")
    before, rest = content.split(begin)
    path.write_text(f"{before}{begin}\n{text}\n{end}{rest.split(end)[1]}")
