"""The learned block: the same bits however cut, weights that survive the disk, and a preset that registers."""

from dataclasses import replace

import pytest
import torch
from closeness import close
from determinism import assert_nothing_shows, same_bits
from problems import garbage_in_invalid_slots, room_pair

import torchreg as tr
from torchreg.descriptors.learned import Learned, LearnedColor, load_weights, save_weights

RADIUS = 0.6


def described(cloud, near=None):
    near = tr.neighbors(cloud, RADIUS, 40) if near is None else near
    return Learned(radius=RADIUS).describe(tr.estimate_normals(cloud, near), near)


def test_the_shipped_block_has_its_name_and_width():
    scan = room_pair(500).source
    features = described(scan)
    assert features.blocks == (("learned", 33),)
    assert bool(features.valid.any())
    assert torch.isfinite(features.values).all()
    assert not features.values.requires_grad


def test_neither_threads_nor_pieces_nor_garbage_change_a_bit():
    scan = room_pair(2500).source
    near = tr.neighbors(scan, RADIUS, 40)
    assert_nothing_shows(lambda: described(scan, near))
    assert same_bits(described(scan, near), described(scan, garbage_in_invalid_slots(near)))


def test_a_batch_equals_the_loop_over_its_clouds():
    made = [room_pair(count, seed=count).source for count in (300, 501, 40)]
    together = described(tr.Clouds.pack(made)).values
    assert same_bits(together, torch.cat([described(one).values for one in made]))


def test_a_radius_a_point_is_that_radius():
    scan = room_pair(300).source
    near = tr.neighbors(scan, RADIUS, 40)
    cloud = tr.estimate_normals(scan, near)
    each = torch.full((len(scan.points),), RADIUS, dtype=torch.float64)
    one, other = (Learned(radius=RADIUS).describe(cloud, replace(near, radius=radius)) for radius in (each, RADIUS))
    assert close(one.values, other.values, atol=1e-3)


def test_weights_survive_the_disk(tmp_path):
    torch.manual_seed(3)
    model = LearnedColor(bins=7, channels=("hue", "value"), hidden=4)
    torch.nn.init.normal_(model.weight_layer.weight)
    again = load_weights(save_weights(model, tmp_path / "weights.json"))
    for one, other in zip(model.state_dict().values(), again.state_dict().values(), strict=True):
        assert same_bits(one, other)
    assert again.channels == ("hue", "value")


def test_weights_with_the_old_names_of_layers_are_read(tmp_path):
    path = save_weights(load_weights(), tmp_path / "weights.json")
    old = path.read_text().replace("cue_layer.", "say_in.").replace("weight_layer.", "say_out.")
    assert all(f'"{layer}.{part}"' in old for layer in ("say_in", "say_out") for part in ("weight", "bias"))
    path.write_text(old)
    assert same_bits(tuple(load_weights(path).state_dict().values()), tuple(load_weights().state_dict().values()))


@pytest.mark.parametrize("effort", ["plain", "fast"])
def test_the_preset_registers_a_pair(effort):
    room = room_pair(1500)
    spacing = float(tr.spacing(room.source)[0])
    options = replace(
        tr.LEARNED,
        normal_radius=2 * spacing,
        feature_radius=5 * spacing,
        color_radius=2 * spacing,
        ransac=replace(tr.LEARNED.ransac, inlier_threshold=1.5 * spacing),
        effort=effort,
    )
    result = tr.register(room.source, room.target, options)
    assert bool(result.success[0]), result.reason
    assert float(tr.metrics.rre(room.T_target_source, result.T_target_source)) < 5
    again = tr.register(room.source, room.target, options)
    assert same_bits(result.T_target_source, again.T_target_source)


def test_the_preset_differs_from_the_paper_in_its_color_alone():
    changed = {"descriptors", "weights", "root"}
    for name in tr.PAPER.__dataclass_fields__:
        same = getattr(tr.PAPER, name) == getattr(tr.LEARNED, name)
        assert same == (name not in changed), name
