"""Files that were damaged give a cloud or a refusal, in every format of the table, in bounded memory and time."""

import os
import subprocess
import sys
from pathlib import Path

import mutations
import pytest
from mutations import case, readable_suffixes, seeds_of

HERE = Path(__file__).resolve().parent
linux = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the memory is limited by means of Linux")


def python(*arguments):
    """A process that finds the package and these tests."""
    paths = [str(HERE), str(HERE.parents[1]), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths)), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-W", "error", *map(str, arguments)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def run(folder, cases):
    """Lines of ``fuzz_run.py`` over all formats, ``cases`` files each; a process that dies is a failure."""
    done = python(HERE / "fuzz_run.py", folder, cases, *readable_suffixes())
    assert done.returncode == 0, (
        f"code {done.returncode}, last in {folder}\n{done.stdout[-4000:]}\n{done.stderr[-2000:]}"
    )
    return [line.split() for line in done.stdout.splitlines()]


def test_every_format_that_is_read_has_whole_files_to_damage(tmp_path):
    assert [suffix for suffix in readable_suffixes() if not seeds_of(suffix, tmp_path)] == []


def test_a_case_is_the_same_in_every_run(tmp_path):
    seeds = seeds_of(".ply", tmp_path)
    assert case(".ply", 7, seeds) == case(".ply", 7, seeds)
    assert len({case(".ply", number, seeds) for number in range(100)}) > 90


def assert_both_outcomes(lines, cases):
    """Neither outcome is rare enough that the damage would be too small or too large to show anything."""
    assert [suffix for suffix, _, _ in lines] == list(readable_suffixes())
    for suffix, read, refused in lines:
        assert int(read) + int(refused) == cases, suffix
        assert min(int(read), int(refused)) > cases // 50, (suffix, read, refused)


@linux
def test_a_few_hundred_damaged_files_of_every_format(tmp_path):
    assert_both_outcomes(run(tmp_path, 300), 300)


@linux
@pytest.mark.slow
def test_thirty_thousand_damaged_files(tmp_path):
    cases = 30_000 // len(readable_suffixes()) + 1
    assert_both_outcomes(run(tmp_path, cases), cases)


@linux
@pytest.mark.parametrize(
    ("reader", "reported"),
    [
        ("raise KeyError(path)", "KeyError"),
        ("import numpy; numpy.ones(1 << 28)", "MemoryError"),
        ("import warnings; warnings.warn('loose')", "UserWarning"),
        ("import os; os.kill(os.getpid(), 11)", "code -11"),
    ],
)
def test_what_a_bad_reader_does_is_reported(tmp_path, reader, reported):
    """The fuzzer can fail."""
    (tmp_path / "broken.py").write_text(
        "import sys, fuzz_run\n"
        "from pathlib import Path\n"
        "def read(path):\n"
        f"    {reader}\n"
        "sys.exit(fuzz_run.main(Path(sys.argv[1]), 3, ['.ply'], read))\n"
    )
    done = python(tmp_path / "broken.py", str(tmp_path))
    assert done.returncode != 0
    assert reported in f"code {done.returncode} {done.stdout}"


def test_checksums_of_pages_are_those_of_the_format(tmp_path):
    for content in seeds_of(".e57", tmp_path):
        pages = [content[k : k + 1024] for k in range(0, len(content), 1024)]
        assert [mutations._checksum(page[:-4]).to_bytes(4, "big") for page in pages] == [page[-4:] for page in pages]
