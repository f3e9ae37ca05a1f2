"""Tutorials and concepts run as they stand, from the first block to the last, in an empty folder."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [
    page
    for folder in ("tutorials", "concepts")
    for page in sorted((ROOT / "docs" / folder).glob("*.md"))
    if "```python" in page.read_text()
]


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_runs(page, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    command = tmp_path / "bin" / "torchreg"  # that of this checkout
    command.parent.mkdir()
    command.write_text(
        f"#!{sys.executable}\nfrom torchreg_command import main\n\nif __name__ == '__main__':\n    main()\n"
    )
    command.chmod(0o755)
    environment = {**os.environ, "PATH": f"{command.parent}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    names: dict[str, object] = {"__name__": "__main__"}
    blocks = re.findall(r"^```(python|sh)\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)
    assert blocks
    for language, block in blocks:
        if language == "python":
            exec(compile(block, str(page), "exec"), names)
        else:
            run = subprocess.run(["bash", "-euo", "pipefail", "-c", block], capture_output=True, env=environment)
            assert run.returncode == 0, run.stderr.decode()
