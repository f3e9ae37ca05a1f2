"""Reads an E57 project and a LAS cloud in coordinates of a map, and writes all scans in the map: as E57 and as LAS.

The files are simulated here. Coordinates far from zero keep all their digits: clouds have an origin in float64.
"""

import torch

import torchreg as tr
from torchreg.io import posed_scan, write_scans
from torchreg.site import SiteFrame

near, far = (tr.datasets.mall(seed=1, baseline=meters, angular_step=1.2, relight=0.3) for meters in (2.0, 8.0))
identity, T_map = torch.eye(4, dtype=torch.float64), torch.eye(4, dtype=torch.float64)
T_map[:3, 3] = torch.tensor([691_000.0, 5_335_000.0, 520.0])  # UTM and height
write_scans("project.e57", [posed_scan(near.source, identity, name="A"), posed_scan(far.source, identity, name="B")])
tr.write_cloud("mapped.las", near.target, T=T_map)

files = [*tr.read_scans("mapped.las"), *tr.read_scans("project.e57")]
site = tr.register_site([file.cloud for file in files], effort="fast", frame=SiteFrame(fix=0))  # the first one stays
print(site.summary())
placed = [
    posed_scan(file.cloud, T, pose=file.pose, name=file.scan or "mapped")
    for file, T, group in zip(files, site.T_world_scan, site.group.tolist(), strict=True)
    if group == 0
]
write_scans("placed.e57", placed)  # every scan as it was, with its pose
for scan in placed:
    tr.write_cloud(f"{scan.name}.las", scan.in_file())  # every point in the map
