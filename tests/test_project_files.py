"""Files for people and tools beside the package: they agree with it, and with each other."""

import re
from pathlib import Path

import pytest

import torchreg as tr

ROOT = Path(__file__).parents[1]
WANTED = re.findall(
    r'"([\w-]+)(?:\[\w+\])?>=([\d.]+)',
    re.search(r"^dependencies = \[.*?^\]", (ROOT / "pyproject.toml").read_text(), re.M | re.S)[0],
)
PAGES = ["CONTRIBUTING.md", "SECURITY.md", "CODE_OF_CONDUCT.md", "CHANGELOG.md"]


def test_the_newest_release_of_the_changelog_is_the_version():
    releases = re.findall(r"^## \[(\d+\.\d+\.\d+)\] - \d{4}-\d\d-\d\d$", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert releases[0] == tr.__version__
    assert releases == sorted(releases, key=lambda text: [int(part) for part in text.split(".")], reverse=True)


def test_the_bounds_are_read():
    assert {"torch", "laspy", "pye57"} <= {name for name, _ in WANTED}


def test_the_recipe_asks_for_what_the_package_does():
    """By bounds: names differ between the two worlds."""
    recipe = (ROOT / "recipe" / "meta.yaml").read_text().partition("  run:")[2]
    bounds = dict(re.findall(r"^    - ([\w-]+?)(?:-base)? >=([\d.]+)$", recipe, re.M))
    for name, bound in WANTED:
        name = {"torch": "pytorch"}.get(name, name)
        if name not in ("libusb-package", "python-neo-lzf"):  # other packages there
            assert bounds[name] == bound, name


def test_the_table_of_dependencies_has_all_and_their_bounds():
    table = (ROOT / "docs" / "dependencies.md").read_text()
    for name, bound in WANTED:
        (row,) = [
            line
            for line in table.splitlines()
            if line.startswith("|") and name in line.split("|")[1].replace(",", " ").split()
        ]
        names = [one.strip() for one in row.split("|")[1].split(",")]
        bounds = [one.strip() for one in row.split("|")[3].split(",")]
        assert bounds[min(names.index(name), len(bounds) - 1)] == bound, name


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page):
    for link in re.findall(r"\]\(([^)\s]+)\)", (ROOT / page).read_text()):
        assert "://" in link or (ROOT / link.partition("#")[0]).exists(), link


def test_the_container_copies_what_is_there():
    text = (ROOT / "Dockerfile").read_text()
    files = [word for line in re.findall(r"^COPY (.+)$", text, re.M) for word in line.split()[:-1]]
    assert "torchreg" in files
    assert [file for file in files if not (ROOT / file).exists()] == []
    kept = (ROOT / ".dockerignore").read_text().splitlines()
    assert {f"!{file}" for file in files} <= set(kept)
