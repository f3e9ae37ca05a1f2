"""The result of a site as files: ``poses.csv`` and JSON."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Sequence

from torchreg.errors import expect
from torchreg.io.atomic import write_text
from torchreg.io.result_json import plain_data, versions
from torchreg.site.result import SiteResult

POSE_COLUMNS = tuple(f"m{row}{column}" for row in range(4) for column in range(4))


def write_poses_csv(path: str | os.PathLike[str], site: SiteResult, names: Sequence[str]) -> None:
    """Write the poses of all scans as a table: scan, group, and m00 to m33, ``T_world_scan`` row by row.

    Group and pose are empty where a scan is not placed. Lengths are in meters; numbers have as many digits as it takes
    to read them back exactly.

    Args:
        path: in a folder that exists.
        site: of N scans.
        names: of the scans, N.

    Raises:
        ValueError: another number of names, or no such folder.
    """
    _expect_names(site, names)
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(("scan", "group", *POSE_COLUMNS))
    for name, group, T in zip(names, site.group.tolist(), site.T_world_scan.flatten(1).tolist(), strict=True):
        table.writerow((name, group, *map(repr, T)) if group >= 0 else (name, "", *[""] * 16))
    write_text(path, text.getvalue())


def site_to_dict(site: SiteResult, names: Sequence[str], *, seed: int) -> dict[str, object]:
    """A site as plain numbers, texts and lists, ready for JSON.

    Numbers that are not finite become ``None`` (in JSON ``null``).

    Args:
        site: of N scans.
        names: of the scans, N.
        seed: what the site was registered with.

    Returns:
        A dictionary with the keys

        - ``scans``: a list of name, group (``None`` where not placed), T_world_scan (4 x 4, meters), covariance (6 x 6,
          rotations in radians about ``center`` before translations in meters), center, reason, notes;
        - ``pairs``: a list of source, target (numbers of scans, from 0), success, reason, candidates (how many);
        - ``links``: a list of the candidates of all pairs, with the fields of ``Link`` and the verdict: used, weight,
          meters, degrees, loops, loop_meters, loop_degrees, as ``SiteLink`` describes them;
        - ``scale``; ``seed``; ``seconds``: by stage; ``versions``.

    Raises:
        ValueError: another number of names.
    """
    _expect_names(site, names)
    scans = [
        {
            "name": names[scan],
            "group": int(site.group[scan]) if placed else None,
            "T_world_scan": site.T_world_scan[scan] if placed else None,
            "covariance": site.covariance[scan] if placed else None,
            "center": site.center[scan] if placed else None,
            "reason": site.reason[scan],
            "notes": site.notes[scan],
        }
        for scan, placed in enumerate(site.placed.tolist())
    ]
    content = {
        "scans": scans,
        "pairs": site.pairs,
        "links": [{**vars(one.link), **dict(zip(one._fields[1:], one[1:], strict=True))} for one in site.links],
        "scale": site.scale,
        "seed": seed,
        "seconds": dict(site.seconds),
        "versions": versions(),
    }
    return {key: plain_data(value) for key, value in content.items()}


def _expect_names(site: SiteResult, names: Sequence[str]) -> None:
    expect(len(names) == len(site), "names", f"one per scan ({len(site)})", len(names))
