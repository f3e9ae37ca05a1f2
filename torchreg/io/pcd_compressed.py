"""The compressed body of a PCD file: two sizes, then all columns one after another, packed as LZF.

LibLZF unpacks it, behind checks of both sizes: Open3D 0.20 crashes on some damaged headers, and where x, y, z
differ in type it finds no points.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import lzf
import numpy as np

from torchreg.io.checks import refuse, require
from torchreg.io.table import Column, Columns, record_dtype

_LARGEST_RATIO = 88  # the longest reference of LZF: 264 bytes from 3


def read_compressed(path: Path, columns: Sequence[Column], rows: int, offset: int) -> Columns:
    """Read a compressed body; the arguments and the result are those of ``read_binary``.

    Raises:
        CloudFileError: sizes that disagree with the header or the file, or bytes that are no LZF.
    """
    with path.open("rb") as file:
        file.seek(offset)
        body = file.read()
    require(len(body) >= 8, path, "8 bytes with the sizes of the compressed points", f"{len(body)} bytes")
    packed, full = (int(size) for size in np.frombuffer(body, "<u4", count=2))
    wanted = rows * record_dtype(columns).itemsize
    require(full == wanted, path, f"{wanted} bytes when uncompressed, as its header declares", f"{full}")
    require(packed <= len(body) - 8, path, f"{packed} compressed bytes", f"{len(body) - 8}")
    possible = full <= packed * _LARGEST_RATIO  # before LibLZF takes memory for them
    require(possible, path, f"{full} bytes when uncompressed", f"{packed} compressed bytes, too few for so many")
    try:
        plain = lzf.decompress(body[8 : 8 + packed], full)  # None where there are more
    except ValueError as error:
        refuse(path, "LZF-compressed points", str(error))
    if plain is None or len(plain) != full:
        refuse(path, f"{full} bytes when uncompressed", "more" if plain is None else f"{len(plain)}")
    found: Columns = {}
    start = 0
    for column in columns:
        values = np.frombuffer(plain, column.dtype, count=rows * column.count, offset=start)
        first = values.reshape(rows, column.count)[:, 0]
        found.setdefault(column.name.lower(), first.astype(column.dtype.newbyteorder("=")))
        start += values.nbytes
    return found
