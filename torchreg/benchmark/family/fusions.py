"""Which descriptors are fused with what: every one that the library has, without being told of it.

A descriptor joins the study by its name in ``torchreg.descriptors.DESCRIPTORS``. Each stands alone, at the support of
the default and at a wider one; beside FPFH; beside the color that the default fuses FPFH with, in FPFH's place; and
beside all that the default has. Entries of histograms are also moved to their square roots, of FPFH and the default.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from torchreg.descriptors import DESCRIPTORS
from torchreg.descriptors.descriptor import Descriptor
from torchreg.descriptors.fpfh import Fpfh
from torchreg.errors import expect
from torchreg.registration import RegistrationOptions, options_for

SUPPORT = 5.0
"""Voxels, the support radius of FPFH and color in the default."""

WIDE = 8.0
"""Voxels, the wider support, with as many more neighbors as a wider disk holds."""

_WEIGHT = 1.0  # of the descriptor, as FPFH's in the default


@dataclass(frozen=True)
class Fusion:
    """One set of descriptors, fused.

    Attributes:
        name: on the command line and in files, such as ``"shot+color"``.
        kind: the descriptor that it is about.
        beside_fpfh: whether FPFH is fused with it.
        beside_color: whether the default's color is, where the clouds have colors.
        support: voxels, the support radius of the descriptor.
        root: as in ``RegistrationOptions``.
    """

    name: str
    kind: type[Descriptor]
    beside_fpfh: bool = False
    beside_color: bool = False
    support: float = SUPPORT
    root: float = 0.0

    def fits(self, *, colored: bool) -> bool:
        """Whether clouds with colors or without can be described so."""
        return colored or self.beside_fpfh or not self.kind.needs_colors

    @property
    def without_color(self) -> bool:
        """Whether it differs from all before it where clouds have no colors."""
        return not self.beside_color and not self.kind.needs_colors

    def options(self, edge: float, *, colored: bool) -> RegistrationOptions:
        """The default's options with these descriptors, for means over voxels of this edge, meters.

        Poses are not refined on the clouds as given at the end, which does not decide whether they are right.
        """
        usual = options_for(edge, colored=colored)
        blocks = [
            each
            for each in zip(usual.descriptors, usual.weights, strict=True)
            if (each[0].needs_colors and self.beside_color) or (isinstance(each[0], Fpfh) and self.beside_fpfh)
        ]
        if colored or not self.kind.needs_colors:
            record = self.kind(radius=self.support * edge)
            more = round(record.max_neighbors * max(1.0, self.support / SUPPORT) ** 2)
            blocks.append((replace(record, max_neighbors=more), _WEIGHT))
        # poses are judged by the first of geometry and of color: the default's, where they are there
        blocks.sort(key=lambda each: each[0].needs_colors)
        return replace(
            usual,
            descriptors=tuple(record for record, _ in blocks),
            weights=tuple(weight for _, weight in blocks),
            root=self.root,
            refine="none",
        )


FPFH = Fusion("fpfh", Fpfh)
"""What the family is set against first."""

DEFAULT = Fusion("fpfh+color", Fpfh, beside_color=True)
"""What ``register`` uses where it derives its options, and what the family is set against second."""

BASES = (FPFH, DEFAULT)


def fusions() -> tuple[Fusion, ...]:
    """All there are, kind by kind of fusion; those of descriptors that the default's color has already are left out."""
    color = {record.name for record in options_for(1.0).descriptors if record.needs_colors}
    kinds = tuple(DESCRIPTORS.values())
    others = [kind for kind in kinds if kind is not Fpfh]
    geometry = [kind for kind in kinds if not kind.needs_colors]
    new = [kind for kind in others if kind.name not in color]
    return (
        *(Fusion(kind.name, kind) for kind in kinds),
        *(Fusion(f"{kind.name}+fpfh", kind, beside_fpfh=True) for kind in others),
        *(Fusion(f"{kind.name}+color", kind, beside_color=True) for kind in geometry),
        *(Fusion(f"{kind.name}+fpfh+color", kind, beside_fpfh=True, beside_color=True) for kind in new),
        *(Fusion(f"{kind.name}/wide", kind, support=WIDE) for kind in kinds),
        *(replace(base, name=f"{base.name}/root", root=1.0) for base in BASES),
    )


def chosen_fusions(names: Sequence[str] | None) -> tuple[Fusion, ...]:
    """Fusions by name, in the order of ``fusions``; ``None`` takes all. The bases are always among them.

    Raises:
        ValueError: a name that no fusion has, or none at all.
    """
    every = {fusion.name: fusion for fusion in fusions()}
    if names is None:
        return tuple(every.values())
    expect(len(names) > 0, "fusions", "at least one", names)
    for name in names:
        expect(name in every, "fusions", "names out of " + ", ".join(every), name)
    wanted = {*names, *(base.name for base in BASES)}
    return tuple(fusion for name, fusion in every.items() if name in wanted)
