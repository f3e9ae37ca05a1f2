"""Options that describe all points warn where there are hundreds of thousands of them."""

import warnings

import pytest

import torchreg as tr
from torchreg.registration.inspect import warn_of_many_points


@pytest.mark.parametrize("options", [tr.PAPER, tr.LEARNED], ids=["PAPER", "LEARNED"])
def test_many_points_are_warned_of_in_words(options):
    with pytest.warns(UserWarning, match="set voxel_size, or thin the clouds"):
        warn_of_many_points(280_000, options)


@pytest.mark.parametrize(("points", "options"), [(10_000, tr.PAPER), (280_000, tr.RegistrationOptions(voxel_size=0.1))])
def test_few_points_and_voxels_are_not(points, options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_many_points(points, options)


def test_register_warns_before_it_works(monkeypatch):
    monkeypatch.setattr("torchreg.registration.inspect._MANY_POINTS", 500)
    pair = tr.datasets.mall(seed=1, angular_step=4.0)
    with pytest.warns(UserWarning, match="such as PAPER"):
        tr.register(pair.source, pair.target, tr.RegistrationOptions(solver=tr.RansacOptions(hypotheses=100)))
