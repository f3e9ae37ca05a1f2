"""What runs and pairs were told, as texts that are compared: whoever goes on must mean the same."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchreg.batch.pairs import Pair
from torchreg.batch.rows import RETRIED
from torchreg.errors import expect
from torchreg.registration.options import RegistrationOptions

if TYPE_CHECKING:
    from torchreg.batch.store import Finished


def options_text(options: RegistrationOptions) -> str:
    """All options."""
    return json.dumps(asdict(options), sort_keys=True)


def pair_text(pair: Pair) -> str:
    """All that was said of a pair."""
    said = {
        "source": pair.source_text,
        "target": pair.target_text,
        **pair.settings.flat(),
        "truth": pair.truth,
        **dict(pair.extra),
    }
    return json.dumps(said, sort_keys=True)


def same_pairs(pairs: Sequence[Pair], finished: Mapping[str, Finished]) -> None:
    """Refuse pairs whose finished row was told something else; one that failed may be corrected.

    Raises:
        ValueError: a pair was told something else, which the message names.
    """
    for pair in pairs:
        row = finished.get(pair.name)
        if row is None or row.state in RETRIED:
            continue
        different = differences(json.loads(row.said), json.loads(pair_text(pair)))
        if different:
            expected = "what it was when it was finished, or a new folder"
            raise ValueError(f"pair {pair.name}: expected {expected}, got {different}")


def same_run(known: Path, manifest: Mapping[str, Any]) -> None:
    """Refuse a run that was told something else than the one that began a folder.

    Raises:
        ValueError: something differs, which the message names, or the file is no manifest.
    """
    try:
        then = json.loads(known.read_text())
        expect(isinstance(then, dict), str(known), "the options of a run", then)
    except ValueError as error:
        raise ValueError(f"{known}: expected the options of a run, got another file ({error})") from None
    different = differences(then, manifest)
    if different:
        raise ValueError(
            f"out: expected a new folder or the options that {known.parent} was begun with, got {different}"
        )


def differences(then: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """What was told differently, in words; empty where nothing was."""
    names = [name for name in {**then, **now} if then.get(name) != now.get(name)]
    return ", ".join(f"{name} {then.get(name)!r} there and {now.get(name)!r} now" for name in names)
