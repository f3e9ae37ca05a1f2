"""Puts all scans of a folder into one frame, without a first guess or an order, and writes a page that shows them.

The folder is filled with four scans of a simulated hall here; put the name of yours in its place.
"""

from pathlib import Path

import torchreg as tr
from torchreg.report import write_site_report

folder = Path("scans")
folder.mkdir(exist_ok=True)
near, far = (tr.datasets.mall(seed=1, baseline=meters, angular_step=1.2, relight=0.3) for meters in (2.0, 8.0))
for number, scan in enumerate((far.source, near.source, near.target, far.target)):
    tr.write_cloud(folder / f"station_{number}.ply", scan)

files = sorted(folder.glob("*.ply"))
scans = [tr.read_cloud(file) for file in files]
site = tr.register_site(scans, effort="fast")
print(site.summary())
for file, T, group, reason in zip(files, site.T_world_scan, site.group.tolist(), site.reason, strict=True):
    x, y, z = T[:3, 3].tolist()  # of the scanner, in meters
    print(file.name, f"stands at {x:.3f}, {y:.3f}, {z:.3f}" if group == 0 else f"is left out: {reason}")
write_site_report("site.html", site, scans, names=[file.stem for file in files])  # opens in any browser
# The same on the command line, resumable: torchreg site scans/*.ply --out results --report site.html
