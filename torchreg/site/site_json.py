"""The result of a site as JSON."""

from __future__ import annotations

from collections.abc import Sequence

from torchreg.errors import expect
from torchreg.io.result_json import plain_data, versions
from torchreg.site.result import SiteResult


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
        - ``scale``; ``doubt``; ``seed``; ``versions``. No times: the same run gives the same bytes.

    Raises:
        ValueError: another number of names.
    """
    expect(len(names) == len(site), "names", f"one per scan ({len(site)})", len(names))
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
        "doubt": site.doubt,
        "seed": seed,
        "versions": versions(),
    }
    return {key: plain_data(value) for key, value in content.items()}
