"""README and docs: their links lead somewhere, their code runs or at least compiles, their tables can be rewritten."""

import ast
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BENCH = sorted(path.stem for path in (ROOT / "bench").glob("*.py"))


def code(page):
    return re.findall(r"^```python\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)


def anchors(page):
    titles = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_bytes()) <= 10 * 1024


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    links = re.findall(r"\]\(([^)\s]+)\)", page.read_text())
    for link in links:
        file, _, anchor = link.partition("#")
        if "://" not in link:
            assert (page.parent / file).exists(), link
            assert not anchor or anchor in anchors(page.parent / file), link


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_code_compiles_and_files_that_are_named_exist(page):
    for block in code(page):
        ast.parse(block)
    for file in re.findall(r"`((?:bench|notebooks|torchreg|tests)/[\w./]+)`", page.read_text()):
        assert (ROOT / file).exists(), file
    for script in re.findall(r"python (bench/\w+\.py)", page.read_text()):
        assert (ROOT / script).exists(), script


def test_git_ignores_what_the_readmes_commands_write():
    if not (ROOT / ".git").exists():
        pytest.skip("not a clone")
    commands = "\n".join(re.findall(r"^```sh\n(.*?)^```", (ROOT / "README.md").read_text(), re.DOTALL | re.MULTILINE))
    files = re.findall(r"--(?:figure|json|aligned|matches|report|merged|out) (\S+)", commands) + re.findall(
        r"convert \S+ (\S+)", commands
    )
    files += re.findall(r"`torchreg demo --figure (\S+)`", (ROOT / "README.md").read_text())
    assert len(files) >= 9
    for file in files:
        path = f"{file}/x" if "." not in file else file
        assert subprocess.run(["git", "check-ignore", "-q", path], cwd=ROOT).returncode == 0, file


def test_the_readmes_options_are_what_they_say():
    names = {}
    exec(code(ROOT / "README.md")[1], names)
    options = names["options"]
    assert [record.name for record in options.descriptors] == ["fpfh", "contrast"]
    assert (options.effort, options.solver.name, options.inlier_threshold) == ("balanced", "ransac", 0.075)


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 2])
def test_the_readmes_code_runs_as_it_stands(number, capsys):
    blocks = code(ROOT / "README.md")
    assert len(blocks) == 3
    names = {}
    exec(blocks[number], names)
    assert bool(names["result"].success[0])
    error = names["result"].T_target_source[0] @ torch.linalg.inv(names["pair"].T_target_source.view(4, 4))
    assert float((error - torch.eye(4)).abs().max()) < 0.5


@pytest.fixture
def bench(monkeypatch):
    """Modules of bench/ by name."""
    monkeypatch.syspath_prepend(str(ROOT / "bench"))
    yield importlib.import_module
    for name in BENCH:
        sys.modules.pop(name, None)


@pytest.mark.parametrize("name", BENCH)
def test_every_benchmark_can_be_imported(bench, name):
    assert bench(name).__doc__


def test_every_block_that_a_benchmark_writes_is_in_one_page(bench):
    blocks = set()
    for name in BENCH:
        text = (ROOT / "bench" / f"{name}.py").read_text()
        blocks |= set(re.findall(r'publish\(\s*"([^"]+)"', text))
    blocks |= {"sensitivity sweep", "sensitivity learn"}
    pages = [page.read_text() for page in PAGES]
    for block in blocks:
        assert sum(page.count(f"<!-- begin: {block} -->") for page in pages) == 1, block
        assert sum(page.count(f"<!-- end: {block} -->") for page in pages) == 1, block
    written = {block for page in pages for block in re.findall(r"<!-- begin: (.+?) -->", page)}
    assert written == blocks


def test_publish_replaces_a_block_and_nothing_else(bench, monkeypatch, tmp_path):
    common = bench("common")
    (tmp_path / "docs" / "benchmarks").mkdir(parents=True)
    page = tmp_path / "docs" / "benchmarks" / "a.md"
    page.write_text("above\n<!-- begin: a -->\nold\n<!-- end: a -->\nbelow\n")
    (tmp_path / "README.md").write_text("nothing")
    monkeypatch.setattr(common, "ROOT", tmp_path)
    monkeypatch.setattr(common, "DOCS", tmp_path / "docs")
    common.publish("a", "new")
    assert page.read_text() == "above\n<!-- begin: a -->\nnew\n<!-- end: a -->\nbelow\n"
    with pytest.raises(SystemExit, match="expected one page"):
        common.publish("b", "new")
