"""PLY and PCD files made byte by byte, so that no library's writer stands between a test and a reader."""

import struct
from pathlib import Path

import numpy as np

PLY_ENCODINGS = ("ascii", "binary_little_endian", "binary_big_endian")
PCD_ENCODINGS = ("ascii", "binary", "binary_compressed")
_PLY_WORDS = {
    **{"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "u4": "uint"},
    **{"i1": "char", "i2": "short", "i4": "int"},
}


def named(names, values, dtype):
    """Columns of an array (N, len(names)), by name."""
    values = np.asarray(values, dtype=dtype)
    return {name: values[:, i] for i, name in enumerate(names)}


def write_ply(path, columns, encoding="binary_little_endian", declared=None, before="", before_bytes=b"", extra=""):
    """Write columns by name; ``declared`` is the vertex count that the header claims."""
    rows = len(next(iter(columns.values()), ()))
    header = ["ply", f"format {encoding} 1.0", *before.splitlines()]
    header.append(f"element vertex {rows if declared is None else declared}")
    header += [f"property {_PLY_WORDS[values.dtype.str[1:]]} {name}" for name, values in columns.items()]
    header += [*extra.splitlines(), "end_header", ""]
    order = ">" if "big" in encoding else "<"
    body = _lines(columns) if encoding == "ascii" else _records(columns, order)
    Path(path).write_bytes("\n".join(header).encode() + before_bytes + body)
    return Path(path)


def write_pcd(path, columns, encoding="binary", declared=None, viewpoint="0 0 0 1 0 0 0", body=None):
    """Write columns by name; ``declared`` is the point count that the header claims."""
    rows = len(next(iter(columns.values()), ())) if declared is None else declared
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS " + " ".join(columns),
        "SIZE " + " ".join(str(values.dtype.itemsize) for values in columns.values()),
        "TYPE " + " ".join(values.dtype.kind.upper() for values in columns.values()),
        "COUNT " + " ".join("1" for _ in columns),
        f"WIDTH {rows}",
        "HEIGHT 1",
        f"VIEWPOINT {viewpoint}",
        f"POINTS {rows}",
        f"DATA {encoding}",
        "",
    ]
    if body is None:
        body = {"ascii": _lines, "binary": _records, "binary_compressed": compressed}[encoding](columns)
    Path(path).write_bytes("\n".join(header).encode() + body)
    return Path(path)


def compressed(columns):
    """Columns one after another in LZF, as literal runs of up to 32 bytes."""
    plain = b"".join(values.astype(values.dtype.newbyteorder("<")).tobytes() for values in columns.values())
    runs = [plain[i : i + 32] for i in range(0, len(plain), 32)]
    packed = b"".join(bytes([len(run) - 1]) + run for run in runs)
    return struct.pack("<II", len(packed), len(plain)) + packed


def pack_rgb(colors):
    """(N,) uint32, 0x00RRGGBB, of colors (N, 3) uint8."""
    red, green, blue = np.asarray(colors, dtype=np.uint32).T
    return red << 16 | green << 8 | blue


def _lines(columns):
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    return "".join(" ".join(map(repr, row)) + "\n" for row in rows).encode()


def _records(columns, order="<"):
    dtype = [(name, values.dtype.newbyteorder(order)) for name, values in columns.items()]
    table = np.empty(len(next(iter(columns.values()), ())), dtype=dtype)
    for name, values in columns.items():
        table[name] = values
    return table.tobytes()
