"""Read damaged files, in a process of its own that a fault may end: ``python fuzz_run.py FOLDER CASES SUFFIX...``.

Each must give a cloud or a ``CloudFileError``: no other exception or warning, no more than 1 GiB beyond what the
process had before, no more than 20 seconds. The last file is ``FOLDER/case`` with its suffix; those that failed stay in
FOLDER. Writes a line a suffix, "SUFFIX read refused", and the traces of failures; ends with 1 where there is any.
"""

import resource
import shutil
import signal
import sys
import traceback
from pathlib import Path

from mutations import case, seeds_of

from torchreg.errors import CloudFileError
from torchreg.io import read_cloud_report

MOST_MEMORY = 1 << 30  # bytes
MOST_SECONDS = 20
MOST_FAILURES = 10


def main(folder, cases, suffixes, read=read_cloud_report):
    seeds = {suffix: seeds_of(suffix, folder) for suffix in suffixes}
    for suffix, whole in seeds.items():
        for content in whole:  # also loads what readers load with the first file
            (folder / f"case{suffix}").write_bytes(content)
            read_cloud_report(folder / f"case{suffix}")
    limit = memory_of_this_process() + MOST_MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    signal.signal(signal.SIGALRM, too_slow)
    failures = 0
    for suffix in suffixes:
        counts = {"read": 0, "refused": 0}
        for number in range(cases):
            path = folder / f"case{suffix}"
            path.write_bytes(case(suffix, number, seeds[suffix]))
            try:
                counts[outcome(path, read)] += 1
            except Exception:
                failures += 1
                kept = shutil.copy(path, folder / f"failed_{number}{suffix}")
                sys.stdout.write(f"FAILED on {kept}\n{traceback.format_exc()}\n")
                if failures >= MOST_FAILURES:
                    return 1
        sys.stdout.write(f"{suffix} {counts['read']} {counts['refused']}\n")
        sys.stdout.flush()
    return int(failures > 0)


def outcome(path, read):
    """Whether a file is read or refused; anything else is raised."""
    signal.alarm(MOST_SECONDS)
    try:
        assert len(read(path).cloud) == 1
    except CloudFileError as error:
        message = str(error)
    else:
        return "read"
    finally:
        signal.alarm(0)
    assert message.startswith(f"{path}: expected "), message
    assert "MemoryError" not in message, message
    return "refused"


def too_slow(*_):
    raise TimeoutError(f"more than {MOST_SECONDS} s for one file")


def memory_of_this_process():
    """Its address space, in bytes."""
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]))
