"""Clouds and results in and out: files, and the types of other libraries."""

from torchreg.io.assemble import CloudFile
from torchreg.io.cloud_file import each_scan, read_cloud, read_cloud_report, read_scans, write_cloud, write_scans
from torchreg.io.fields import PointFields
from torchreg.io.formats import CLOUD_SUFFIXES
from torchreg.io.library_clouds import from_pyg, from_pytorch3d, to_pyg, to_pytorch3d
from torchreg.io.numpy_clouds import NumpyCloud, from_numpy, to_numpy
from torchreg.io.open3d_clouds import from_open3d, to_open3d
from torchreg.io.pairs_file import PairRow, read_pairs_file
from torchreg.io.posed import PosedScan, posed_scan
from torchreg.io.reading import Reading
from torchreg.io.result_json import result_to_dict, write_result_json
from torchreg.io.transform_formats import TRANSFORM_FORMATS
from torchreg.io.transform_text import read_transform_text, write_transform_text
from torchreg.io.verification_json import verification_to_dict

__all__ = [
    "CLOUD_SUFFIXES",
    "TRANSFORM_FORMATS",
    "CloudFile",
    "NumpyCloud",
    "PairRow",
    "PointFields",
    "PosedScan",
    "Reading",
    "each_scan",
    "from_numpy",
    "from_open3d",
    "from_pyg",
    "from_pytorch3d",
    "posed_scan",
    "read_cloud",
    "read_cloud_report",
    "read_pairs_file",
    "read_scans",
    "read_transform_text",
    "result_to_dict",
    "to_numpy",
    "to_open3d",
    "to_pyg",
    "to_pytorch3d",
    "verification_to_dict",
    "write_cloud",
    "write_result_json",
    "write_scans",
    "write_transform_text",
]
