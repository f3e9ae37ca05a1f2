"""Peak memory of a registration of 100,000 points a cloud, and the time that importing takes.

python bench/footprint.py             writes bench/results/footprint.json and docs/benchmarks/footprint.md
"""

from __future__ import annotations

from statistics import median

from common import bench_parser, in_words, machine, peak_bytes, publish, run_python, save

POINTS = 100_000
IMPORTS = 7

MAKE = f"""
from torchreg.registration import options_for
pair = tr.datasets.mall(seed=0)
clouds = [tr.random_downsample(cloud, {POINTS}) for cloud in (pair.source, pair.target)]
del pair
"""
WORK = """
scale = float(max(tr.spacing(cloud) for cloud in clouds))
result = tr.register(*clouds, options_for(scale))
more = {"success": bool(result.success), "seconds": dict(result.seconds)}
"""

IMPORT = "import time, torch; begin = time.perf_counter(); import torchreg; print(time.perf_counter() - begin)"


def main() -> None:
    arguments = bench_parser(__doc__).parse_args()
    memory = peak_bytes(MAKE, WORK)
    imports = [run_python("-c", IMPORT) for _ in range(IMPORTS)]
    facts = machine()
    gibibytes = memory["bytes"] / 2**30
    text = (
        f"Registering two clouds of {POINTS:,} points, 100 neighbors each, takes {gibibytes:.2f} GiB above what the "
        f"imports and the clouds hold. `import torchreg` takes {median(imports):.2f} s beyond `import torch` "
        f"(median of {IMPORTS}; {in_words(facts)})."
    )
    print(text)
    save("footprint", {"machine": facts, "memory": memory, "import_seconds": imports})
    if not arguments.no_docs:
        publish("footprint", text)


if __name__ == "__main__":
    main()
