"""Features given as tensors on the real pairs beside the checkout, by the protocol of ``torchreg bench features``.

    python bench/features.py           FPFH, random numbers and the default; an unfinished run is resumed
    python bench/features.py --saved   the tables from bench/results/features.json, nothing measured

Rows go to build/features. Written: bench/results/features.json and the tables of docs/benchmarks/features.md. For other
features take ``torchreg bench features``.
"""

from __future__ import annotations

import json
import shutil

import torch
from common import REAL, RESULTS, ROOT, bench_parser, in_words, listed_pairs, publish, table
from torch import Tensor

import torchreg as tr
from torchreg.benchmark.core.study import run_study
from torchreg.benchmark.features.adapter import FPFH, adapter_methods
from torchreg.benchmark.features.document import tables
from torchreg.benchmark.features.protocol import Protocol
from torchreg.benchmark.features.study import features_study
from torchreg.benchmark.peers import METHODS
from torchreg.benchmark.peers.comparison import ComparisonOptions, MethodComparison

OUT = ROOT / "build" / "features"
WIDTH = 32
RANDOM = "features:noise"
BESIDE = ("default",)


def noise(cloud: tr.Clouds) -> Tensor:
    """Features that know nothing: what is found by them is found by what the library tries beside them."""
    generator = torch.Generator().manual_seed(len(cloud.points))
    return torch.randn(len(cloud.points), WIDTH, generator=generator)


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("--saved", action="store_true", help="write the documents from saved results, nothing measured")
    arguments = parser.parse_args()
    if not arguments.saved:
        listed_pairs()
        OUT.mkdir(parents=True, exist_ok=True)
        study = features_study([RANDOM], REAL, ComparisonOptions(methods=BESIDE))
        run_study(study, OUT, lambda line: print(line, flush=True))
        shutil.copy(OUT / "features.json", RESULTS / "features.json")
    content = json.loads((RESULTS / "features.json").read_text())
    methods = [*FPFH, METHODS["default"], *adapter_methods(RANDOM)]
    comparison = MethodComparison(content["rows"], methods, content["gaps"], content["run"]["seed"])
    text = "\n\n".join(table(one.head, one.rows) for one in tables(comparison, Protocol(in_meters=False))[:2])
    print(text)
    if not arguments.no_docs:
        publish("given features", f"{text}\n\n{in_words(content['machine'])}.")


if __name__ == "__main__":
    main()
