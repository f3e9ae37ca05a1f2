"""Results as JSON, and the quaternion in them."""

import json
import math
import os
import platform
import socket
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from problems import turned
from results import OPTIONS, PROPOSALS, STAGES, bare_result, candidate, failed_result, verified_result

from torchreg.geometry.se3 import quaternion_wxyz
from torchreg.io import read_transform_text, result_to_dict, write_result_json
from torchreg.io.result_json import plain_data
from torchreg.registration.options import RegistrationOptions
from torchreg.types import Clouds, Correspondences, Failure, HypothesisCounts, RegistrationResult

quick = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def matrix_of(w, x, y, z):
    """The rotation of a unit quaternion, by its definition: v -> q v q*."""
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


parts = st.one_of(st.floats(-1, 1), st.sampled_from([0.0, 1.0, -1.0, 1e-9, -1e-9]))


@quick
@given(q=st.tuples(parts, parts, parts, parts).filter(lambda q: np.linalg.norm(q) > 1e-3))
def test_quaternion_against_its_definition(q):
    q = np.array(q) / np.linalg.norm(q)
    found = quaternion_wxyz(torch.from_numpy(matrix_of(*q))).numpy()
    assert found.dtype == np.float64
    assert found[0] >= 0
    assert abs(np.linalg.norm(found) - 1) < 1e-15 * 4
    assert min(np.abs(found - q).max(), np.abs(found + q).max()) < 1e-14
    np.testing.assert_allclose(matrix_of(*found), matrix_of(*q), atol=1e-14)


def test_quaternion_of_batches_and_float32():
    q = torch.nn.functional.normalize(torch.randn(5, 4, generator=torch.Generator().manual_seed(0)), dim=1)
    R = torch.from_numpy(np.stack([matrix_of(*row) for row in q.double().numpy()])).float()
    found = quaternion_wxyz(R)
    assert found.dtype == torch.float32
    torch.testing.assert_close(found, q * torch.sign(q[:, :1]), atol=1e-6, rtol=0)


def a_result(seed=0, rmse=0.01):
    rng = np.random.default_rng(seed)
    T = torch.eye(4, dtype=torch.float64).repeat(2, 1, 1)
    q = rng.normal(size=4)
    T[0, :3, :3] = torch.from_numpy(matrix_of(*(q / np.linalg.norm(q))))
    T[0, :3, 3] = torch.from_numpy(rng.normal(size=3) * 1e6)
    rows, clouds = torch.arange(5), Clouds(torch.zeros(5, 3), offsets=torch.tensor([0, 3, 5]))
    return RegistrationResult(
        T_target_source=T,
        inliers=torch.tensor([True, False, True, False, True]),
        fitness=torch.tensor([0.75, 0.0], dtype=torch.float64),
        inlier_rmse=torch.tensor([rmse, float("nan")], dtype=torch.float64),
        success=torch.tensor([True, False]),
        failure=(None, Failure("too few matches", "too few matches: 2, 3 are needed", {"matches": 2, "needed": 3})),
        hypotheses=HypothesisCounts(*(torch.tensor([n, 0]) for n in (600, 50, 7))),
        source=clouds,
        target=clouds,
        correspondences=Correspondences(rows, rows, clouds.offsets, torch.rand(5)),
        options=(RegistrationOptions(), RegistrationOptions()),
        notes=(("no colors",), ()),
        seconds=(("normals", 0.5), ("ransac", float("inf"))),
    )


NAMES = {"seed": 7, "source": "a.ply", "target": "b.ply"}


@quick
@given(seed=st.integers(0, 1000))
def test_json_round_trip(tmp_path, seed):
    result = a_result(seed)
    path = tmp_path / "r.json"
    write_result_json(path, result, **NAMES)
    found = json.loads(path.read_text(), parse_constant=pytest.fail)
    assert found == result_to_dict(result, **NAMES)
    assert torch.equal(read_transform_text(path), result.T_target_source[0])
    assert found["translation"] == result.T_target_source[0, :3, 3].tolist()
    rotation = matrix_of(*(found["quaternion"][key] for key in "wxyz"))
    np.testing.assert_allclose(rotation, result.T_target_source[0, :3, :3].numpy(), atol=1e-14)


def test_fields():
    found = result_to_dict(a_result(), **NAMES)
    assert found["counts"] == {
        "correspondences": 3,
        "inliers": 2,
        "hypotheses_drawn": 600,
        "hypotheses_kept": 50,
        "hypotheses_scored": 7,
    }
    assert (found["success"], found["reason"], found["failure"], found["notes"]) == (True, "", None, ["no colors"])
    assert (found["seed"], found["source"], found["target"]) == (7, "a.ply", "b.ply")
    assert (found["fitness"], found["inlier_rmse"]) == (0.75, 0.01)
    assert found["options"]["solver"]["hypotheses"] == 600_000
    assert found["options"]["descriptors"][1]["channels"] == ["hue"]
    assert not any(name.startswith("_") for name in found["options"])
    assert found["seconds"] == {"normals": 0.5, "ransac": None}
    assert found["versions"]["torch"] == torch.__version__
    assert found["versions"]["python"] == platform.python_version()
    host = socket.gethostname()
    assert host not in json.dumps(found) or host in platform.release()


def test_a_failed_pair(tmp_path):
    found = result_to_dict(a_result(), 1, **NAMES)
    assert (found["success"], found["reason"], found["notes"]) == (False, "too few matches: 2, 3 are needed", [])
    assert found["failure"] == {"kind": "too few matches", "figures": {"matches": 2, "needed": 3}}
    assert found["inlier_rmse"] is None
    assert (found["counts"]["correspondences"], found["counts"]["inliers"]) == (2, 1)
    for key in ("T_target_source", "quaternion", "translation", "likeliest_T_target_source"):
        assert found[key] is None  # there is no pose at all
    write_result_json(tmp_path / "r.json", a_result(), 1, **NAMES)
    with pytest.raises(ValueError, match="a registration that succeeded, got one that failed"):
        read_transform_text(tmp_path / "r.json")


def test_the_pose_of_a_refused_pair_has_a_key_of_its_own(tmp_path):
    """So that nobody who reads ``T_target_source`` takes a pose that is not trusted for one that is."""
    result = failed_result("ambiguous", T_target_source=turned(10)[None])
    write_result_json(tmp_path / "r.json", result, **NAMES)
    found = json.loads((tmp_path / "r.json").read_text())
    assert (found["T_target_source"], found["quaternion"], found["translation"]) == (None, None, None)
    assert found["likeliest_T_target_source"] == turned(10).tolist()
    with pytest.raises(ValueError, match="a registration that succeeded, got one that failed"):
        read_transform_text(tmp_path / "r.json")
    assert result_to_dict(verified_result(), **NAMES)["likeliest_T_target_source"] is None


REFINED = ("residual_median", "residual_rms", "residual_95", "covariance", "center", "axis_strength")
KEYS = [
    *("source", "target", "success", "reason", "failure", "notes", "T_target_source", "quaternion", "translation"),
    "likeliest_T_target_source",
    *(
        "fitness",
        "inlier_rmse",
        "probability",
        "overlap",
        "strength",
        "information",
        "runner_up",
        "margin",
    ),
    *REFINED,
    "candidates",
    *("stages", "counts", "seed", "options", "seconds", "versions"),
]


def test_what_weighing_the_pose_gave(tmp_path):
    result = verified_result()
    write_result_json(tmp_path / "r.json", result, **NAMES)
    found = json.loads((tmp_path / "r.json").read_text(), parse_constant=pytest.fail)
    assert list(found) == KEYS
    assert (found["probability"], found["overlap"], found["strength"]) == (0.998, 0.52, 0.31)
    assert (found["margin"], found["runner_up"]) == (5.2, turned(100, translation=(3.0, 4.0, 0.0)).tolist())
    assert found["information"] == result.information[0].tolist()
    best, probe = found["candidates"]
    assert best == {**candidate()._asdict(), "T_target_source": turned(10).tolist()}
    assert (probe["origin"], probe["colors"]) == ("slide", None)
    assert found["stages"] == {
        "given": {"source": 30433, "target": 28001},
        "points": {"source": 9812, "target": 9950},
        "described": {"source": 9700, "target": 9950},
        "proposals": [proposal._asdict() for proposal in PROPOSALS],
    }
    assert STAGES.proposals == PROPOSALS
    assert found["options"]["match_neighbors"] == OPTIONS.match_neighbors


def test_what_refining_the_pose_gave():
    figures = {
        **{name: torch.tensor([place / 1000], dtype=torch.float64) for place, name in enumerate(REFINED[:3], start=1)},
        "covariance": 1e-8 * torch.eye(6, dtype=torch.float64)[None],
        "center": torch.tensor([[1.0, 2.0, 3.0]], dtype=torch.float64),
        "axis_strength": torch.linspace(0, 0.5, 6, dtype=torch.float64)[None],
    }
    found = result_to_dict(verified_result(**figures), **NAMES)
    assert {name: found[name] for name in REFINED} == {name: value[0].tolist() for name, value in figures.items()}
    unrefined = result_to_dict(verified_result(**{name: value * math.nan for name, value in figures.items()}), **NAMES)
    assert json.dumps(unrefined["covariance"]) == json.dumps(unrefined["residual_median"]) == "null"


def test_numbers_that_are_not_there_are_none():
    none = result_to_dict(bare_result(), **NAMES)
    assert list(none) == KEYS
    for key in ("probability", "overlap", "strength", "information", "runner_up", "margin", *REFINED, "stages"):
        assert none[key] is None
    assert none["candidates"] == []
    nan = torch.full((1, 4, 4), float("nan"), dtype=torch.float64)
    alone = result_to_dict(
        verified_result(runner_up=nan, margin=torch.tensor([float("inf")], dtype=torch.float64)), **NAMES
    )
    assert (alone["runner_up"], alone["margin"]) == (None, None)


def test_every_key_is_documented():
    for key in KEYS:
        assert f"``{key}``" in result_to_dict.__doc__


@dataclass(frozen=True)
class Inner:
    size: float = math.inf


@dataclass(frozen=True)
class Named:
    name: ClassVar[str] = "named"
    inner: Inner = Inner()
    shape: tuple[int, ...] = (1, 2)


def test_records_become_plain_under_their_name():
    """Options may hold records, whatever they are: nested, several, with a class's name."""
    content = plain_data({"records": (Named(), Inner(2.0)), "tensor": torch.tensor([1.5, math.nan]), "text": "a"})
    assert content == {
        "records": [{"name": "named", "inner": {"size": None}, "shape": [1, 2]}, {"size": 2.0}],
        "tensor": [1.5, None],
        "text": "a",
    }
    assert plain_data(RegistrationOptions()) == json.loads(json.dumps(plain_data(RegistrationOptions())))


def test_refused(tmp_path):
    for pair in (-1, 2):
        with pytest.raises(ValueError, match=r"^pair: expected a number from 0 to 1, got "):
            result_to_dict(a_result(), pair, **NAMES)
    with pytest.raises(ValueError, match=r"^pair: "):
        write_result_json(tmp_path / "r.json", a_result(), 2, **NAMES)
    assert os.listdir(tmp_path) == []
