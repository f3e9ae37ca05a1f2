"""The pages build without a network and without a warning, and their search knows what people look for."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
NEEDED = ("sphinx", "furo", "myst_parser")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of all pages as HTML."""
    missing = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        pytest.skip(f'pip install -e ".[docs]" brings {", ".join(missing)}, which build the pages')
    out = tmp_path_factory.mktemp("pages")
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", ROOT / "docs", out]
    run = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    assert run.returncode == 0, run.stderr
    return out


@pytest.mark.slow
def test_the_pages_build_without_a_warning(site):
    assert (site / "index.html").exists()
    assert (site / "api" / "types.html").read_text().count("torchreg.Clouds") > 0


@pytest.mark.slow
@pytest.mark.parametrize("word", ["color", "e57", "probabl"])  # as the index has them: stems, in small letters
def test_a_search_finds(site, word):
    index = (site / "searchindex.js").read_text()
    assert f'"{word}":' in index or f"{word}:" in index


@pytest.mark.slow
def test_the_pages_fetch_nothing(site):
    for page in site.rglob("*.html"):
        text = page.read_text()
        for mark in ('src="http', 'rel="stylesheet" href="http', "url(http"):
            assert mark not in text, f"{page.relative_to(site)} has {mark}"
