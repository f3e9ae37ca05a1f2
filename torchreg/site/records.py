"""What pairs found and what scans look like, as texts that are kept and handed between processes: no bit is lost."""

from __future__ import annotations

import json
from dataclasses import fields
from typing import Any

import torch
from torch import Tensor

from torchreg.registration.inspect import CloudFacts
from torchreg.registration.scales import Scale
from torchreg.site.links import Link
from torchreg.site.result import TriedPair
from torchreg.site.scans import ScanLook
from torchreg.site.work import PairFound
from torchreg.types import Failure

_SHAPES = {"T_target_source": (4, 4), "covariance": (6, 6), "center": (3,)}
_NAMES = tuple(field.name for field in fields(Link))


def text_of_found(found: PairFound) -> str:
    """A pair as one line; numbers as ``repr`` writes them, which reads back to the same bits."""
    links = [[_plain(getattr(link, name)) for name in _NAMES] for link in found.links]
    return json.dumps([found.tried, links])


def found_of_text(text: str, source: int, target: int) -> PairFound:
    """The pair of such a line, its scans numbered anew.

    Raises:
        ValueError: another text.
    """
    try:
        tried, links = json.loads(text)
        pair = TriedPair(*tried)._replace(source=source, target=target)
        return PairFound(pair, tuple(_link(values, source, target) for values in links))
    except (TypeError, KeyError) as error:
        raise ValueError(f"expected a pair as it was kept, got {text[:80]!r} ({error})") from None


def text_of_look(look: ScanLook) -> str:
    """A look at a scan as one line."""
    facts, defect = look.facts, look.facts.defect
    shown = None if defect is None else [defect.kind, defect.text, dict(defect.figures)]
    return json.dumps([facts._replace(defect=None), shown, look.digest, look.scale, look.coarse])


def look_of_text(text: str) -> ScanLook:
    """The look of such a line.

    Raises:
        ValueError: another text.
    """
    try:
        values, defect, digest, *scales = json.loads(text)
        facts = CloudFacts(*values)
        facts = facts._replace(
            defect=None if defect is None else Failure(*defect),
            colors=None if facts.colors is None else (facts.colors[0], facts.colors[1]),
        )
        return ScanLook(facts, digest, *(None if scale is None else Scale(*scale) for scale in scales))
    except (TypeError, KeyError) as error:
        raise ValueError(f"expected a look at a scan as it was kept, got {text[:80]!r} ({error})") from None


def _plain(value: Any) -> Any:  # noqa: ANN401
    return value.flatten().tolist() if isinstance(value, Tensor) else value


def _link(values: list[Any], source: int, target: int) -> Link:
    given = dict(zip(_NAMES, values, strict=True))
    for name, shape in _SHAPES.items():
        given[name] = torch.tensor(given[name], dtype=torch.float64).view(shape)
    return Link(**{**given, "source": source, "target": target})
