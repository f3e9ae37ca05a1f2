"""A verification as JSON: plain numbers, and null where there is none."""

import json
import math

import torch
from refusals import refuses
from results import failed_result, number, verification

import torchreg as tr
from torchreg.io import read_transform_text, result_to_dict, verification_to_dict


def content_of(result, pair=0):
    content = verification_to_dict(result, pair, seed=7, source="a.ply", target="b.ply")
    return json.loads(json.dumps(content, allow_nan=False))


def test_every_field_is_there_as_it_is():
    result = verification()
    content = content_of(result)
    names = ("T_target_source", "settled", "likeliest", "probability", "deviation_meters", "deviation_degrees")
    for name in (*names, "residual_median", "residual_rms", "residual_95"):
        assert content[name] == getattr(result, name)[0].tolist()
    assert (content["success"], content["reason"], content["failure"]) == (True, "", None)
    assert content["candidate"]["overlap"] == 0.47
    assert content["rival"]["origin"] == "slide"
    search = result_to_dict(result.search, seed=7, source="a.ply", target="b.ply")
    assert content["search"] == json.loads(json.dumps(search))


def test_what_there_is_not_is_null():
    nowhere = torch.full((1, 4, 4), math.nan, dtype=torch.float64)
    failure = tr.Failure("too few points", "too few points: 2", {"points": 2})
    result = verification(
        success=torch.tensor([False]),
        failure=(failure,),
        settled=nowhere,
        likeliest=nowhere,
        deviation_meters=number(math.nan),
        residual_median=number(math.nan),
        candidate=(None,),
        settled_candidate=(None,),
        rival=(None,),
        search=failed_result("too few points"),
    )
    content = content_of(result)
    for name in (
        "settled",
        "likeliest",
        "deviation_meters",
        "residual_median",
        "candidate",
        "settled_candidate",
        "rival",
    ):
        assert content[name] is None
    assert content["failure"] == {"kind": "too few points", "figures": {"points": 2}}
    assert content["reason"] == "too few points: 2"
    with refuses("pair"):
        content_of(result, 1)


def test_a_right_transform_can_be_read_back(tmp_path):
    result = verification()
    (tmp_path / "a.json").write_text(json.dumps(content_of(result)))
    assert torch.equal(read_transform_text(tmp_path / "a.json"), result.T_target_source[0])
