"""Peak memory of a registration of 100,000 points a cloud, and the time that importing takes.

python bench/footprint.py             writes bench/results/footprint.json and the lines in README.md
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from statistics import median
from typing import Any

from common import in_words, machine, save
from readme import put_into_readme

POINTS = 100_000
IMPORTS = 7

MEMORY = f"""
import json, resource
import torchreg as tr
from torchreg.open3d_loader import load_open3d
from torchreg.registration import options_for
load_open3d()
def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
pair = tr.datasets.mall(seed=0)
clouds = [tr.random_downsample(cloud, {POINTS}) for cloud in (pair.source, pair.target)]
del pair
open('/proc/self/clear_refs', 'w').write('5')  # the peak counts from here
before = [int(line.split()[1]) * 1024 for line in open('/proc/self/status') if line.startswith('VmRSS')][0]
scale = float(max(tr.spacing(cloud) for cloud in clouds))
result = tr.register(*clouds, options_for(scale))
after = [int(line.split()[1]) * 1024 for line in open('/proc/self/status') if line.startswith('VmHWM')][0]
print(json.dumps({{"bytes": after - before, "success": bool(result.success), "seconds": dict(result.seconds)}}))
"""

IMPORT = "import time, torch; begin = time.perf_counter(); import torchreg; print(time.perf_counter() - begin)"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--no-readme", action="store_true", help="leave README.md as it is")
    arguments = parser.parse_args()
    memory: dict[str, Any] = json.loads(_output(MEMORY))
    imports = [float(_output(IMPORT)) for _ in range(IMPORTS)]
    facts = machine()
    gibibytes = memory["bytes"] / 2**30
    text = (
        f"Registering two clouds of {POINTS:,} points, 100 neighbors each, takes {gibibytes:.2f} GiB above what the "
        f"imports and the clouds hold. `import torchreg` takes {median(imports):.2f} s beyond `import torch` "
        f"(median of {IMPORTS}; {in_words(facts)})."
    )
    print(text)
    save("footprint", {"machine": facts, "memory": memory, "import_seconds": imports})
    if not arguments.no_readme:
        put_into_readme("footprint", text)


def _output(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip().splitlines()[-1]


if __name__ == "__main__":
    main()
