"""Damaged files of every format: small whole ones, and seeded changes to their bytes, words, lines and members."""

import io
import random
import re
import struct
import zipfile

import numpy as np
import torch
from hand_made_files import PCD_ENCODINGS, PLY_ENCODINGS, named, pack_rgb, write_pcd, write_ply

from torchreg.io.cloud_file import write_cloud
from torchreg.io.formats import READERS, WRITERS
from torchreg.types import Clouds

_RNG = np.random.default_rng(0)
_POINTS, _COLORS = _RNG.uniform(-9, 9, (12, 3)), _RNG.integers(0, 256, (12, 3))
_COLUMNS = {
    **named(("x", "y", "z"), _POINTS, "f4"),
    **named(("nx", "ny", "nz"), _POINTS, "f4"),
    **named(("red", "green", "blue"), _COLORS, "u1"),
}
_FACES = "element face 2\nproperty list uchar int vertex_indices"
_VIEWPOINT = "comment viewpoint 1 2 3\nobj_info made"


def ply_seeds(folder):
    """In every encoding, plain and with lists before the vertices."""
    for encoding in PLY_ENCODINGS:
        yield write_ply(folder / "a.ply", _COLUMNS, encoding, before=_VIEWPOINT).read_bytes()
        order = ">" if "big" in encoding else "<"
        faces = b"".join(struct.pack(f"{order}B{n}i", n, *range(n)) for n in (3, 4))
        faces = b"3 0 1 2\n4 0 1 2 3\n" if encoding == "ascii" else faces
        yield write_ply(folder / "a.ply", _COLUMNS, encoding, before=_FACES, before_bytes=faces).read_bytes()
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 3\n"
    header += (
        "".join(f"property float {name}\n" for name in "xyz") + "property list ushort double weights\nend_header\n"
    )
    rows = (struct.pack(f"<3fH{n}d", n, 1, 2, n, *range(n)) for n in range(3))
    yield header.encode() + b"".join(rows)


def pcd_seeds(folder):
    """In every encoding, with colors as channels and packed."""
    packed = {**named(("x", "y", "z"), _POINTS, "f8"), "rgb": pack_rgb(_COLORS).view("f4")}
    for encoding in PCD_ENCODINGS:
        for columns in (_COLUMNS, packed):
            yield write_pcd(folder / "a.pcd", columns, encoding, viewpoint="1 2 3 1 0 0 0").read_bytes()


def npz_seeds(folder):
    """Stored and deflated."""
    for save in (np.savez, np.savez_compressed):
        buffer = io.BytesIO()
        save(buffer, points=_POINTS, colors=_COLORS, normals=_POINTS, origin=_POINTS[0], viewpoint=_POINTS[1])
        yield buffer.getvalue()


def ptx_seeds(folder):
    """One scan of a grid with colors and a beam without a return, in a frame of its own."""
    rows = [f"{x:.4f} {y:.4f} {z:.4f} 0.{k:02d} {r} {g} {b}" for k, ((x, y, z), (r, g, b)) in enumerate(_both())]
    head = ["3", "4", "1 2 3", "1 0 0", "0 1 0", "0 0 1", "1 0 0 0", "0 1 0 0", "0 0 1 0", "1 2 3 1"]
    yield "\n".join([*head, *rows[:-1], "0 0 0 0.5 0 0 0", ""]).encode()


def pts_seeds(folder):
    """A count, then points with intensity and color."""
    rows = [f"{x:.4f} {y:.4f} {z:.4f} {9 * k - 50} {r} {g} {b}" for k, ((x, y, z), (r, g, b)) in enumerate(_both())]
    yield "\n".join([str(len(rows)), *rows, ""]).encode()


def _both():
    return zip(_POINTS, _COLORS, strict=True)


def written_seeds(suffix):
    """What the format's own writer writes, for formats without seeds of their own."""

    def seeds(folder):
        path = folder / f"a{suffix}"
        write_cloud(path, Clouds(torch.from_numpy(_POINTS), colors=torch.from_numpy(_COLORS / 255)))
        yield path.read_bytes()

    return seeds


SEEDS = {".ply": ply_seeds, ".pcd": pcd_seeds, ".npz": npz_seeds, ".ptx": ptx_seeds, ".pts": pts_seeds}
"""What yields whole files of a suffix, given a folder to write in; a format that has a writer may do without."""


def seeds_of(suffix, folder):
    """The bytes of small whole files; an empty list where nothing makes any."""
    make = SEEDS.get(suffix) or (written_seeds(suffix) if suffix in WRITERS else None)
    return list(make(folder)) if make else []


def readable_suffixes():
    """All suffixes of the table of formats, also of rows that were added later."""
    return tuple(READERS)


_WORD = re.compile(rb"[-+]?\d[\d.]*(?:e[-+]?\d+)?")
_ODD_WORDS = [b"-1", b"0", b"1", b"3", b"65536", b"4294967295", b"999999999999999", b"9223372036854775808", b"1e39"]
_ODD_WORDS += [b"nan", b"-nan(ind)", b"1.#QNAN", b"1,5", b"", b"x", b"1e400", b"7 7", b"268435456", b"1048576"]
_ODD_BYTES = [
    b"\0",
    b"\xff",
    b"\n",
    b"\r",
    b" ",
    b"\xef\xbb\xbf",
    b"\x7f\xff\xff\xff",
    b"\xff\xff\xff\x7f",
    b"\0\0\xc0\x7f",
]
_ODD_BYTES += [b"\xff" * 8, b"\0" * 8, b"\0\0\0\x10", b"\xff\xff\xff\xff\xff\xff\xff\x7f"]


def mutated(content, others, draw):
    """The bytes of a file, changed one to three times; ``draw`` is a ``random.Random``."""
    for _ in range(draw.choice([1, 1, 1, 2, 3])):
        inside = [change for magic, change in _INSIDE.items() if content.startswith(magic)]
        change = inside[0] if inside and draw.random() < 0.8 else draw.choice(_CHANGES)
        content = change(content, others, draw) or b"\0"
    return content


def _change_bytes(content, others, draw):
    content = bytearray(content)
    for _ in range(draw.randint(1, 4)):
        content[draw.randrange(len(content))] = draw.randrange(256)
    return bytes(content)


def _flip_a_bit(content, others, draw):
    place = draw.randrange(len(content))
    return content[:place] + bytes([content[place] ^ 1 << draw.randrange(8)]) + content[place + 1 :]


def _write_odd_bytes(content, others, draw):
    odd, place = draw.choice(_ODD_BYTES), draw.randrange(len(content))
    return content[:place] + odd + content[place + draw.choice([0, len(odd)]) :]


def _change_a_number(content, others, draw):
    words = list(_WORD.finditer(content[:4096]))
    if not words:
        return content
    word = draw.choice(words)
    return content[: word.start()] + draw.choice(_ODD_WORDS) + content[word.end() :]


def _cut(content, others, draw):
    return content[: draw.randrange(len(content))]


def _drop_or_repeat(content, others, draw):
    begin = draw.randrange(len(content))
    end = min(begin + draw.choice([1, 2, 4, 8, 64, 500]), len(content))
    return content[:begin] + content[begin:end] * draw.choice([0, 0, 2, 5, 300]) + content[end:]


def _change_lines(content, others, draw):
    lines = content.split(b"\n")
    place, other = draw.randrange(len(lines)), draw.randrange(len(lines))
    kind = draw.randrange(4)
    if kind == 0:
        lines[place], lines[other] = lines[other], lines[place]
    elif kind == 1:
        lines[place:place] = [lines[other]] * draw.choice([1, 1, 3, 2000])
    elif kind == 2:
        del lines[place]
    else:
        lines[place] = b" ".join(draw.sample(words := lines[place].split(b" "), len(words)))
    return draw.choice([b"\n", b"\n", b"\n", b"\r\n", b"\r"]).join(lines)


def _splice(content, others, draw):
    other = draw.choice(others)
    return content[: draw.randrange(len(content))] + other[draw.randrange(len(other)) :]


def _change_a_member(content, others, draw):
    """Of a zip file, so that its checksum fits the damage; where it can no longer be opened, a byte."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        name = draw.choice(list(members))
    except Exception:
        return _change_bytes(content, others, draw)
    members[name] = draw.choice(_CHANGES)(members[name], list(members.values()), draw)
    changed = io.BytesIO()
    with zipfile.ZipFile(changed, "w", draw.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])) as archive:
        for name, member in members.items():
            archive.writestr(name, member)
    return changed.getvalue()


_CHANGES = [_change_bytes, _flip_a_bit, _write_odd_bytes, _change_a_number, _change_a_number, _cut, _drop_or_repeat]
_CHANGES += [_change_lines, _splice]


def _change_pages(content, others, draw):
    """Of an E57 file, the bytes between the checksums of its pages, with checksums that fit the damage."""
    plain, *more = (b"".join(one[k : k + _PAGE] for k in range(0, len(one), _PAGE + 4)) for one in (content, *others))
    plain = draw.choice(_CHANGES)(plain, more, draw)
    plain += b"\0" * (-len(plain) % _PAGE)
    pages = [plain[k : k + _PAGE] for k in range(0, len(plain), _PAGE)]
    return b"".join(page + struct.pack(">I", _checksum(page)) for page in pages)


def _checksum(page):
    """CRC-32C (Castagnoli), as ASTM E2807 has it."""
    value = 0xFFFFFFFF
    for byte in page:
        value = value >> 8 ^ _CHECKSUMS[(value ^ byte) & 255]
    return value ^ 0xFFFFFFFF


def _table():
    for value in range(256):
        for _ in range(8):
            value = value >> 1 ^ (0x82F63B78 if value & 1 else 0)
        yield value


_PAGE = 1020  # bytes of a page before its checksum
_CHECKSUMS = list(_table())
_INSIDE = {b"PK": _change_a_member, b"ASTM-E57": _change_pages}
"""Changes behind the checksums of a format, by the first bytes of its files."""


def case(suffix, number, seeds):
    """The damaged file of this number, the same in every run."""
    draw = random.Random(f"{suffix} {number}")
    return mutated(draw.choice(seeds), seeds, draw)
