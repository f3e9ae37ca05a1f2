"""The pairs of a batch: the rows of a pairs file, or all pairs of some files."""

from __future__ import annotations

import glob
import hashlib
import json
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import torch
from torch import Tensor

from torchreg.arguments import checked_record
from torchreg.entry import entry
from torchreg.errors import expect, expect_in_words
from torchreg.io import CLOUD_SUFFIXES, read_pairs_file
from torchreg.io.formats import AMBIGUOUS_SUFFIXES
from torchreg.settings import PairSettings

_LONGEST = 120  # characters of a file's name that are taken from a pair's
_TAKEN = re.compile(
    r".*-[0-9a-f]{12}"  # as names end that get a digest
    r"|(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?"  # devices of Windows
)


@checked_record
@dataclass(frozen=True, kw_only=True)
class Pair:
    """One pair to be registered.

    Attributes:
        name: different for every pair of the batch.
        source: path of the file.
        target: path of the file.
        source_text: as it was written.
        target_text: as it was written.
        settings: of this pair.
        truth: rows of T_target_source, meters, where it is known.
        extra: other columns, carried into the table.

    Example:
        >>> import torchreg as tr
        >>> from pathlib import Path
        >>> from torchreg.batch import PairSettings, pairs_of_file
        >>> _ = Path("pairs.csv").write_text("source,target\\na.ply,b.ply\\n")
        >>> pairs_of_file(Path("pairs.csv"), PairSettings())[0].source_text
        'a.ply'
    """

    name: str
    source: str
    target: str
    source_text: str
    target_text: str
    settings: PairSettings
    truth: tuple[tuple[float, ...], ...] | None = None
    extra: tuple[tuple[str, str], ...] = ()

    @property
    def file_name(self) -> str:
        """A name for the file of the pair, different for every pair of the batch, on file systems that take capitals
        for small letters and one form of an accent for another as on those that do not.

        It is the pair's name where that has only small letters, digits and ``_.+-``; else a digest follows.
        """
        plain = re.sub(r"[^A-Za-z0-9_.+-]", "_", self.name)[:_LONGEST].lstrip(".")
        if plain and plain == self.name.lower() == self.name and not _TAKEN.fullmatch(plain):
            return plain
        return f"{plain}-{hashlib.blake2b(self.name.encode(), digest_size=6).hexdigest()}"

    @property
    def text(self) -> str:
        """All that was written of the pair, as one text that is compared."""
        written = {
            "source": self.source_text,
            "target": self.target_text,
            **self.settings.flat(),
            "truth": self.truth,
            **dict(self.extra),
        }
        return json.dumps(written, sort_keys=True)

    def transform(self) -> Tensor | None:
        """The true T_target_source (4, 4) float64, where it is known."""
        return None if self.truth is None else torch.tensor(self.truth, dtype=torch.float64)


@entry
def pairs_of_file(path: Path, settings: PairSettings) -> tuple[Pair, ...]:
    """The pairs that a table or a list lists; see ``read_pairs_file`` and ``PairSettings`` for its columns.

    In a table, a column whose name is nearly that of a setting is refused, as a slip of the pen. The lists that
    programs write have names of their own, which go into the results.

    Raises:
        ValueError: the file cannot be read, or a cell has no meaning; the message names the line or the pair.

    Example:
        >>> from pathlib import Path
        >>> from torchreg.batch import PairSettings, pairs_of_file
        >>> _ = Path("pairs.csv").write_text("source,target,voxel\\na.ply,b.ply,0.1\\n")
        >>> pair, = pairs_of_file(Path("pairs.csv"), PairSettings())
        >>> pair.name, pair.settings.voxel
        ('a__b', 0.1)
    """
    known = settings.flat()
    by_hand = path.suffix.lower() != ".json"
    return tuple(
        Pair(
            name=row.name,
            source=os.path.abspath(row.source),
            target=os.path.abspath(row.target),
            source_text=row.source_text,
            target_text=row.target_text,
            settings=settings.with_columns(
                {name: text for name, text in row.extra.items() if by_hand or name in known}, row.where
            ),
            truth=None if row.T_target_source is None else tuple(map(tuple, row.T_target_source.tolist())),
            extra=tuple((name, text) for name, text in row.extra.items() if name not in known),
        )
        for row in read_pairs_file(path)
    )


@entry
def pairs_of_glob(pattern: str, settings: PairSettings) -> tuple[Pair, ...]:
    """Every two of the files that a pattern names, each pair once, the earlier name as the source.

    Raises:
        ValueError: fewer than two clouds; other files do not count, nor do those that end in .txt or .csv unless the
            pattern ends so.

    Example:
        >>> import torch, torchreg as tr
        >>> from pathlib import Path
        >>> from torchreg.batch import PairSettings, pairs_of_glob
        >>> Path("scans").mkdir(exist_ok=True)
        >>> for name in "abc":
        ...     tr.write_cloud(f"scans/{name}.ply", tr.Clouds(torch.rand(10, 3)))
        >>> [pair.name for pair in pairs_of_glob("scans/*.ply", PairSettings())]
        ['a__b', 'a__c', 'b__c']
    """
    asked_for = Path(pattern).suffix.lower()
    suffixes = {suffix for suffix in CLOUD_SUFFIXES if suffix == asked_for or suffix not in AMBIGUOUS_SUFFIXES}
    named = [file for file in glob.glob(pattern, recursive=True) if Path(file).suffix.lower() in suffixes]
    files = sorted(file for file in named if os.path.isfile(file))
    for file in files:
        legal = file.isprintable() and not any("\ud800" <= letter <= "\udfff" for letter in file)
        expect(legal, "all pairs", "file names that can be written down", file)
    expect_in_words(
        len(files) >= 2,
        "all pairs",
        f"a pattern that names at least two clouds ({', '.join(CLOUD_SUFFIXES)})",
        f"{pattern!r}, which names {files}",
    )
    names = _short_names(files)
    return tuple(
        Pair(
            name=f"{names[source]}__{names[target]}",
            source=os.path.abspath(source),
            target=os.path.abspath(target),
            source_text=source,
            target_text=target,
            settings=settings,
        )
        for source, target in combinations(files, 2)
    )


def _short_names(files: Sequence[str]) -> dict[str, str]:
    """Stems where they tell the files apart, else the paths below the folder that all share."""
    stems = {file: Path(file).stem for file in files}
    if len(set(stems.values())) == len(files) and not any("__" in stem for stem in stems.values()):
        return stems
    folder = os.path.commonpath([os.path.dirname(os.path.abspath(file)) for file in files])
    return {file: os.path.relpath(os.path.abspath(file), folder) for file in files}
