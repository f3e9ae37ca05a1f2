"""``register(..., describe=module)``: a user's module describes, within the plan of ``register``."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from determinism import same_bits
from problems import room_pair
from refusals import refuses
from torch import nn

import torchreg as tr

TIMES = ("seconds",)


class Own(nn.Module):
    """The default's features, by a module."""

    def __init__(self, options):
        super().__init__()
        self.options = options

    def forward(self, cloud, near):
        blocks = [
            record.describe(cloud, near.restrict(record.radius, record.max_neighbors))
            for record in self.options.descriptors
        ]
        return tr.fuse(*blocks, weights=self.options.weights)


class Mean(nn.Module):
    """Heights and colors, through layers that behave otherwise when trained."""

    def __init__(self):
        super().__init__()
        torch.manual_seed(0)
        self.layers = nn.Sequential(nn.Linear(6, 16), nn.BatchNorm1d(16), nn.ReLU(), nn.Dropout(0.5), nn.Linear(16, 8))
        self.calls = []

    def forward(self, cloud):
        assert not torch.is_grad_enabled()
        assert cloud.normals is not None
        self.calls.append((self.training, self.layers[1].training, len(cloud), len(cloud.points)))
        return self.layers(torch.cat([cloud.points, cloud.colors], dim=1))


@pytest.fixture(scope="module")
def room():
    pair = room_pair(1500, seed=3)
    return pair, tr.options_for(float(tr.spacing(pair.source)[0]))


@pytest.mark.parametrize("effort", ["plain", "fast", "balanced"])
def test_a_module_with_the_librarys_features_gives_the_result_of_register(room, effort):
    pair, options = room
    options = replace(options, effort=effort, voxel_size=0.15)
    expected = tr.register(*pair[:2], options)
    assert bool(expected.success[0])
    result = tr.register(*pair[:2], options, describe=Own(options))
    assert same_bits(result, expected, ignore=TIMES)


def test_the_librarys_modules_describe(room):
    pair, options = room
    result = tr.register(*pair[:2], options, describe=tr.nn.FPFH(binning="hard"))
    assert result.success.tolist() == [True], result.reason
    assert float(tr.metrics.rre(pair.T_target_source, result.T_target_source)) < 2
    assert result.stages[0].proposals[0].origin == "fpfh, compatibility"


def test_a_module_is_evaluated_once_for_every_cloud_and_left_as_it_was(room):
    pair, options = room
    module = Mean()
    module.layers[3].eval()  # a part that its user froze
    before = {name: value.clone() for name, value in module.state_dict().items()}
    sources = tr.Clouds.pack([pair.source, pair.source])
    targets = tr.Clouds.pack([pair.target, pair.source])
    tr.register(sources, targets, options, describe=module)
    assert len(module.calls) == 2  # two distinct clouds
    assert all(call[:3] == (False, False, 1) for call in module.calls)
    assert [part.training for part in (module, module.layers[1], module.layers[3])] == [True, True, False]
    assert all(same_bits(value, before[name]) for name, value in module.state_dict().items())


def test_a_batch_equals_the_loop(room):
    pairs = [room_pair(count, seed=seed) for count, seed in ((600, 3), (500, 5))]
    options = [tr.options_for(float(tr.spacing(pair.source)[0])) for pair in pairs]
    module = Mean()
    source, target = (tr.Clouds.pack(side) for side in zip(*(pair[:2] for pair in pairs), strict=True))
    for max_bytes in (None, 1):
        together = tr.register(source, target, options, describe=module, max_bytes=max_bytes)
        for b, (pair, option) in enumerate(zip(pairs, options, strict=True)):
            alone = tr.register(*pair[:2], option, describe=module)
            assert same_bits(together.T_target_source[b : b + 1], alone.T_target_source)
            assert same_bits(together.probability[b : b + 1], alone.probability)


def test_a_function_describes_and_a_refused_pair_stays_refused(room):
    pair, options = room
    empty = tr.Clouds(points=torch.zeros(0, 3), colors=torch.zeros(0, 3))
    sources = tr.Clouds.pack([empty, pair.source])
    targets = tr.Clouds.pack([pair.target, pair.target])
    module = Own(options)
    for max_bytes in (None, 1):  # at 1 byte the refused pair has a slice of its own
        result = tr.register(
            sources, targets, options, describe=lambda cloud, near: module(cloud, near).values, max_bytes=max_bytes
        )
        assert [failure and failure.kind for failure in result.failure] == ["too few points", None]


def test_answers_that_are_no_features_are_refused_by_name(room):
    pair, options = room
    for answer, parts in (
        (lambda cloud: cloud.points[1:], ("describe", "a row for each of")),
        (lambda cloud: cloud.points * torch.nan, ("describe", "finite numbers")),
        (lambda cloud: cloud.points[:, 0], ("describe", "(P, D)")),
        (lambda cloud: cloud.points.long(), ("describe", "floating-point")),
    ):
        with refuses(*parts):
            tr.register(*pair[:2], options, describe=answer)
    with pytest.raises(TypeError, match=r"describe: expected a tensor \(P, D\), Features .* got tuple"):
        tr.register(*pair[:2], options, describe=lambda cloud: (cloud.points,))
    with pytest.raises(TypeError, match="describe: expected a function or None, got 3"):
        tr.register(*pair[:2], options, describe=3)


def test_a_wrapped_module_gets_neighborhoods_as_it_would_alone(room):
    pair, options = room
    alone = Own(options)
    expected = tr.register(*pair[:2], options, describe=alone)
    wrapped = torch.compile(alone, backend="eager")
    assert same_bits(tr.register(*pair[:2], options, describe=wrapped), expected, ignore=TIMES)


def test_what_a_module_raises_comes_with_its_name_and_what_it_was_given(room):
    pair, options = room
    bare = (replace(cloud, colors=None) for cloud in pair[:2])
    with pytest.raises(
        RuntimeError, match=r"^describe: Mean raised TypeError, given .* without colors, .*: "
    ) as caught:
        tr.register(*bare, options, describe=Mean())
    assert isinstance(caught.value.__cause__, TypeError)

    def heights(cloud, near):
        raise KeyError("height")

    with pytest.raises(RuntimeError, match=r"describe: heights raised KeyError, .* colors, and their Neighborhoods"):
        tr.register(*pair[:2], options, describe=heights)
