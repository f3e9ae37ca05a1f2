"""Registers a table of pairs by `torchreg batch`, which keeps every result at once and resumes where it was cut off.

The table lists simulated pairs here; yours needs the columns source and target, and may have name, truth and settings.
"""

import csv
import json
import subprocess
import sys
from pathlib import Path

import torchreg as tr

with open("pairs.csv", "w", newline="") as file:
    table = csv.writer(file)
    table.writerow(["name", "source", "target", "truth"])
    for seed in (1, 3):
        hall = tr.datasets.mall(seed, angular_step=1.2)
        tr.write_cloud(f"{seed}_a.ply", hall.source)
        tr.write_cloud(f"{seed}_b.ply", hall.target)
        truth = " ".join(map(str, hall.T_target_source.flatten().tolist()))  # where it is known: errors follow
        table.writerow([f"hall {seed}", f"{seed}_a.ply", f"{seed}_b.ply", truth])

command = [sys.executable, "-m", "torchreg", "batch", "pairs.csv", "--out", "results", "--workers", "0"]
subprocess.run(command, check=True)
subprocess.run(command, check=True)  # once more: no finished pair is registered again
for pair in json.loads(Path("results/results.json").read_text()):
    print(pair["name"], pair["success"], f"{pair['probability']:.3f}", f"{pair['rre_degrees']:.3f} degrees off")
