"""Whatever is public names the argument that is wrong, what was expected and what came: swept over all there is."""

import inspect
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from numbers import Real
from typing import Any, Literal

import pytest
import torch
from problems import sphere_cloud
from refusals import refuses
from torch import Tensor

import torchreg as tr
from torchreg.arguments import check, checked, kind_of, parameters_of
from torchreg.errors import LARGEST_NUMBER, ArgumentTypeError, at_least, finite, positive
from torchreg.refinement import IcpLevel

NAMESPACES = (tr, tr.nn, tr.synthetic, tr.augment, tr.metrics, tr.batch, tr.learning, tr.datasets, tr.io, tr.site)
OTHERS = {"Clouds", "Descriptor", "native_library", "baselines"}  # checks of its own; abstract; no argument
WRONG: tuple[Any, ...] = (object(), None, "text", 2.5, 3, True, torch.zeros(2), [object()], {}, sphere_cloud(5))
CLOUD = sphere_cloud(60)
NEAR = tr.neighbors(CLOUD, 1.0, 12)
FEATURES = tr.fpfh(CLOUD, NEAR)


def is_made_to_be_called(value):
    """A function, or a class whose constructor takes options; results, which are tuples and records, are made here."""
    if not inspect.isclass(value):
        return inspect.isfunction(value)
    return not issubclass(value, tuple) and "__wrapped__" in vars(vars(value).get("__init__", int))


def public():
    found = {}
    for namespace in NAMESPACES:
        for name in namespace.__all__:
            value = getattr(namespace, name)
            if name not in OTHERS and is_made_to_be_called(value):
                found[f"{namespace.__name__}.{name}"] = value
    return found


PUBLIC = public()


def raw(value):
    return inspect.unwrap(value.__init__ if inspect.isclass(value) else value)


@pytest.mark.parametrize("name", PUBLIC)
def test_every_public_function_and_record_refuses_wrong_types_by_name(name):
    value = PUBLIC[name]
    parameters = parameters_of(raw(value))
    blank = (None,) if inspect.isclass(value) else ()
    count = 0
    for place, parameter in enumerate(parameters.positional[len(blank) :], len(blank)):
        count += refused(value, blank, place, parameter)
    for parameter in parameters.named.values():
        count += refused(value, blank, None, parameter)
    assert count > 0, name


def refused(value, blank, place, parameter):
    """How many of the wrong values are refused for this argument; those that its annotation allows are not tried."""
    wrong = [bad for bad in WRONG if bad is not parameter.default and not parameter.kind.accepts(bad)]
    for bad in wrong:
        with pytest.raises(ArgumentTypeError, match=rf"^{parameter.name}: expected .+, got ") as caught:
            call(value, blank, place, parameter, bad)
        assert isinstance(caught.value, (TypeError, ValueError))
    return len(wrong)


def call(value, blank, place, parameter, bad):
    """Call with one argument; its type is checked before anything is found to be missing."""
    if place is None:
        return value(**{parameter.name: bad})
    others = [each.default for each in parameters_of(raw(value)).positional[len(blank) : place]]
    return value(*others, bad)


def test_functions_are_all_there():
    assert len(PUBLIC) > 90
    assert {"torchreg.register", "torchreg.nn.Register", "torchreg.RansacOptions", "torchreg.metrics.rre"} <= set(
        PUBLIC
    )


SENTENCES = {
    "color": lambda: tr.RegistrationOptions(color=None),
    "ransac": lambda: tr.RegistrationOptions(ransac=None),
    "match": lambda: tr.nn.Register(match=3),
    "source": lambda: tr.register(torch.rand(5, 3), CLOUD),
    "target": lambda: tr.register(CLOUD, torch.rand(5, 3)),
    "seed": lambda: tr.register(CLOUD, CLOUD, seed="1"),
    "radius": lambda: tr.neighbors(CLOUD, 1e300, 5),
    "max_neighbors": lambda: tr.neighbors(CLOUD, 1.0, 2.5),
    "count": lambda: tr.random_downsample(CLOUD, 2**70),
    "voxel_size": lambda: tr.voxel_downsample(CLOUD, math.nan),
    "dustbin": lambda: tr.soft_match(FEATURES, FEATURES, dustbin=math.nan),
    "temperature": lambda: tr.soft_match(FEATURES, FEATURES, temperature=1e300),
    "noise": lambda: tr.synthetic.match_problem(20, 0.5, noise=math.nan),
    "blocks": lambda: tr.Features(FEATURES.values, FEATURES.offsets, 3, FEATURES.valid),
    "near": lambda: tr.fpfh(CLOUD, 3),
    "cloud": lambda: tr.nn.FPFH()(3, NEAR),
    "features": lambda: tr.fuse(CLOUD),
    "solver": lambda: tr.RegistrationOptions(solver=3),
    "scans": lambda: tr.register_site(3),
    "spacing": lambda: tr.options_for("wide"),
}


@pytest.mark.parametrize("name", SENTENCES)
def test_what_users_get_wrong_is_named(name):
    with refuses(name):
        SENTENCES[name]()


def test_messages_of_replaced_options_name_the_argument_too():
    for name in ("color", "ransac"):
        with refuses(name):
            replace(tr.PAPER, **{name: None})


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e300, "1", None, True, 2**70])
def test_numbers_out_of_range_are_refused(bad):
    for kind in (positive, finite):
        with refuses("x"):
            kind(bad, "x")
    with refuses("x"):
        at_least(bad, "x", 0)
    assert positive(LARGEST_NUMBER, "x") == LARGEST_NUMBER


REFLECTED = torch.diag(torch.tensor([-1.0, 1, 1, 1]))
SCALED = torch.diag(torch.tensor([2.0, 2, 2, 1]))
SHEARED = torch.eye(4) + 0.1 * torch.eye(4)[[1, 0, 2, 3]] * torch.tensor([1.0, 0, 0, 0])


@pytest.mark.parametrize(
    ("T", "what"), [(REFLECTED, "a reflection"), (SCALED, "a scale of 2"), (SHEARED, "R R^T off by")]
)
def test_only_rigid_transforms_move_clouds_and_start_icp(T, what):
    for name, move in (("T_to_from", tr.transform), ("T_target_source", lambda cloud, T: tr.icp(cloud, cloud, T))):
        for given in (T, T[None], T.double()):
            with refuses(name, what):
                move(CLOUD, given)
    pair = tr.Clouds.pack([CLOUD, CLOUD])
    with refuses("T_to_from[1]", what):
        tr.transform(pair, torch.stack([torch.eye(4), T]))


def test_a_start_of_icp_that_is_not_finite_fails_alone():
    T = torch.eye(4).repeat(2, 1, 1)
    T[0, 0, 0] = math.nan
    result = tr.icp(tr.Clouds.pack([CLOUD] * 2), tr.Clouds.pack([CLOUD] * 2), T)
    assert result.reason[0] == "the transform to start from is not finite"
    assert result.reason[1] == ""


@pytest.mark.parametrize(
    ("annotation", "right", "wrong", "words"),
    [
        (float, (1, 1.5, math.nan), (True, "1", None, 1j), "a number"),
        (int, (1, 2**100), (1.0, True, "1"), "an integer"),
        (bool, (True,), (1, "yes"), "True or False"),
        (int | None, (None, 3), (2.5,), "an integer or None"),
        (Literal["a", "b"], ("a",), ("c", 1), "'a' or 'b'"),
        (Sequence[str], (["a"], ()), ("a", [1], 3), "a sequence of strings"),
        (tuple[float, float], ((1, 2.0),), ((1,), 3, "ab"), "(a number, a number)"),
        (Sequence[tr.Fpfh], ([tr.Fpfh(radius=1)],), ([3],), "a sequence of Fpfh"),
        (Tensor, (torch.zeros(1),), ([1.0],), "a tensor"),
        (Any, (object(), None), (), ""),
        (float | Any, (object(),), (), ""),
    ],
)
def test_an_annotation_says_what_is_accepted(annotation, right, wrong, words):
    kind = kind_of(annotation)
    assert kind.words == words
    assert all(map(kind.accepts, right))
    assert not any(map(kind.accepts, wrong))


def test_checks_keep_what_a_function_is():
    @checked
    def double(number: Real, *more: int, by: float = 2) -> float:
        """Twice."""
        return by * number

    assert double(3) == 6
    assert double(3, 4, by=0.5) == 1.5
    assert (double.__name__, double.__doc__) == ("double", "Twice.")
    assert str(inspect.signature(double)).startswith("(number: ")
    with refuses("more", "an integer, got 'x'"):
        double(3, "x")
    with pytest.raises(TypeError, match=re.escape("missing 1 required positional argument")):
        double()
    with refuses("by", "a number"):
        check(double.__wrapped__, (3,), {"by": "x"})


def test_records_are_checked_when_they_are_made_and_replaced():
    level = IcpLevel(max_distance=1.0)
    with refuses("max_distance", "a number"):
        replace(level, max_distance="far")
