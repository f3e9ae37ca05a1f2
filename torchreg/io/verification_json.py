"""The verdict on a given transform as JSON."""

from __future__ import annotations

from torchreg.entry import entry
from torchreg.errors import expect
from torchreg.io.result_json import number_or_matrix, plain_data, result_to_dict
from torchreg.types import Verification

_NUMBERS = (
    *("probability", "deviation_meters", "deviation_degrees", "fitness", "inlier_rmse", "overlap"),
    *("residual_median", "residual_rms", "residual_95"),
)
_TRANSFORMS = ("T_target_source", "settled", "likeliest")


@entry
def verification_to_dict(
    result: Verification, pair: int = 0, *, seed: int, source: str, target: str
) -> dict[str, object]:
    """One pair of a verification as plain numbers, texts and lists, ready for JSON.

    Numbers that are not finite become ``None`` (in JSON ``null``), as do poses that there are not.

    Args:
        result: of B pairs.
        pair: which one, from 0 to B - 1.
        seed: what the verification was run with.
        source: name of the source cloud for the file.
        target: name of the target cloud.

    Returns:
        A dictionary with the keys

        - ``source``, ``target``: the names given; ``success``, ``reason`` (empty beside success); ``failure``: kind and
          figures, as ``Failure`` has them, or ``None``;
        - ``T_target_source``, ``settled``, ``likeliest``: 4 x 4, meters;
        - ``probability``, ``deviation_meters``, ``deviation_degrees``, ``fitness``, ``inlier_rmse`` (meters),
          ``overlap``, ``residual_median``, ``residual_rms``, ``residual_95``: numbers, or ``None``;
        - ``candidate``, ``settled_candidate``, ``rival``: as ``Candidate`` describes them, or ``None``;
        - ``search``: what ``result_to_dict`` says of the search, with notes, options, times and versions.

    Raises:
        ValueError: ``pair`` is not one of the result's.

    Example:
        >>> import torchreg as tr
        >>> pair = tr.datasets.mall(seed=1, angular_step=3.0)
        >>> verification = tr.verify(pair.source, pair.target, pair.T_target_source)
        >>> sorted(tr.io.verification_to_dict(verification, seed=0, source="a.ply", target="b.ply"))[:3]
        ['T_target_source', 'candidate', 'deviation_degrees']
    """
    expect(0 <= pair < len(result), "pair", f"a number from 0 to {len(result) - 1}", pair)
    failure = result.failure[pair]
    content = {
        "source": source,
        "target": target,
        "success": bool(result.success[pair]),
        "reason": result.reason[pair],
        "failure": None if failure is None else {"kind": failure.kind, "figures": failure.figures},
        **{name: number_or_matrix(getattr(result, name), pair) for name in (*_TRANSFORMS, *_NUMBERS)},
        "candidate": result.candidate[pair],
        "settled_candidate": result.settled_candidate[pair],
        "rival": result.rival[pair],
        "search": result_to_dict(result.search, pair, seed=seed, source=source, target=target),
    }
    return {key: plain_data(value) for key, value in content.items()}
