"""What all augmentations promise: repeatable draws, batches equal to single calls, gradients, evaluation mode."""

import copy
import pickle

import pytest
import torch
from determinism import same_bits
from problems import seeded
from refusals import refuses

import torchreg as tr
from torchreg import augment
from torchreg.geometry.se3 import transform


def test_same_seed_same_bits_and_every_call_is_another(make, batch):
    first, second = make(generator=seeded(3)), make(generator=seeded(3))
    once = first.tracked(batch)
    assert same_bits(once, second.tracked(batch))
    assert not same_bits(once, first.tracked(batch))
    assert not same_bits(once, make(generator=seeded(4)).tracked(batch))
    assert same_bits(make()(batch), make(generator=seeded(0))(batch))


def test_a_batch_gives_what_its_clouds_give_one_after_another(make, batch):
    together = make(generator=seeded(1)).tracked(batch)
    single = make(generator=seeded(1))
    parts = [single.tracked(cloud) for cloud in batch.unpack()]
    assert same_bits(together.clouds, tr.Clouds.pack([part.clouds for part in parts]))
    assert same_bits(together.T_new_old, torch.cat([part.T_new_old for part in parts]))


def test_global_random_state_is_left_alone(make, batch):
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    make()(batch)
    assert torch.equal(torch.rand(3), expected)


def test_clouds_keep_number_dtype_and_validity(make, batch):
    for dtype in (torch.float32, torch.float64):
        changed = make()(batch.to(dtype=dtype))
        assert len(changed) == 3
        assert changed.points.dtype == changed.colors.dtype == dtype
        assert changed.lengths[1] == 0
        assert all(0 < new <= old for new, old in zip(changed.lengths[::2], batch.lengths[::2], strict=True))
        assert changed.colors.min() >= 0
        assert changed.colors.max() <= 1
        assert torch.allclose(changed.normals.norm(dim=1), torch.ones((), dtype=dtype), atol=1e-5)


def test_bare_clouds_stay_bare(make):
    changed = make()(tr.Clouds(torch.rand(30, 3)))
    assert changed.colors is None
    assert changed.normals is None
    assert changed.viewpoint is None


def test_evaluation_mode_hands_clouds_through(make, batch):
    module = make(generator=seeded(1))
    expected = make(generator=seeded(1))(batch)
    module.eval()
    still = module.tracked(batch)
    assert still.clouds is batch
    assert torch.equal(still.T_new_old, torch.eye(4, dtype=torch.float64).expand(3, 4, 4))
    assert same_bits(module.train()(batch), expected)  # nothing was drawn meanwhile


def test_probability_is_a_chance_for_each_cloud(make, batch):
    assert same_bits(make(probability=0.0)(batch), batch)
    many = tr.Clouds.pack([batch.select(0)] * 200)
    changed = make(probability=0.25)(many).unpack()
    same = sum(same_bits(one, batch.select(0)) for one in changed)
    assert 120 < same < 180


def test_points_move_as_tracked_but_for_noise(make, batch):
    """Every new point lies within the noise (3 x 5 mm) of an old one that was moved."""
    changed = make(generator=seeded(8)).tracked(batch)
    moved = transform(batch, changed.T_new_old)
    for new, old in zip(changed.clouds.unpack(), moved.unpack(), strict=True):
        if len(new.points):
            apart = torch.cdist(new.points.double() + new.origin, old.points.double() + old.origin).amin(dim=1)
            assert apart.max() < 0.03
        assert torch.allclose(new.viewpoint.double() + new.origin, old.viewpoint.double() + old.origin, atol=1e-5)


def test_gradients_reach_points_normals_and_colors(make, batch):
    batch = batch.to(dtype=torch.float64)
    for values in (batch.points, batch.normals, batch.colors):
        values.requires_grad_()
    changed = make(generator=seeded(2))(batch)
    for name in ("points", "normals", "colors"):
        before = getattr(batch, name)
        (gradient,) = torch.autograd.grad(getattr(changed, name).square().sum(), before, retain_graph=True)
        assert gradient.isfinite().all()
        assert gradient.abs().sum() > 0


def test_all_but_voxels_run_where_no_value_can_be_read_back(make, batch):
    """On the meta device there are no values, and a tensor left behind on the CPU is an error."""
    module = make(generator=seeded(2))
    if isinstance(module, augment.RandomVoxels):
        pytest.skip("how many points stay depends on their values")
    expected = make(generator=seeded(2))(batch)
    changed = module.tracked(batch.to("meta"))
    assert changed.clouds.lengths == expected.lengths
    for value in (changed.clouds.points, changed.clouds.colors, changed.clouds.origin, changed.T_new_old):
        assert value.is_meta


def test_copies_and_pickles_go_on_alike(make, batch):
    module = augment.RandomMotion(generator=seeded(6))
    module(batch)
    copied, pickled = copy.deepcopy(module), pickle.loads(pickle.dumps(module))
    expected = module(batch)
    assert same_bits(copied(batch), expected)
    assert same_bits(pickled(batch), expected)
    assert module.state_dict() == {}
    assert "axis='any'" in repr(module)


def test_members_with_equal_places_or_generators_draw_unlike_numbers(batch):
    """Two jitters in a row do not add the same noise twice, and two kinds with equal seeds do not agree."""
    jitter = augment.Jitter(sigma=0.01)
    twice = augment.Compose(augment.Jitter(sigma=0.01), augment.Jitter(sigma=0.01))(batch).points - batch.points
    once = jitter(batch).points - batch.points
    spread = [noise.std().item() for noise in (once, twice)]
    assert spread[1] == pytest.approx(spread[0] * 2**0.5, rel=0.15)
    thin, crop = (kind(keep=(0.1, 0.9)) for kind in (augment.RandomThin, augment.RandomCrop))
    many = tr.Clouds.pack([batch.select(2)] * 20)
    assert thin(many).lengths != crop(many).lengths


def test_modules_that_share_a_generator_share_it_in_copies_too(batch):
    shared = seeded(3)
    pair = torch.nn.ModuleList([augment.Jitter(generator=shared), augment.Jitter(generator=shared)])
    copies = [copy.deepcopy(pair), pickle.loads(pickle.dumps(pair))]
    expected = [module(batch) for module in pair]
    assert not same_bits(expected[0], expected[1])
    for modules in copies:
        assert all(same_bits(module(batch), one) for module, one in zip(modules, expected, strict=True))


def test_a_member_with_a_generator_of_its_own_keeps_to_it(batch):
    own = augment.Jitter(generator=seeded(7))
    composed = augment.Compose(augment.Jitter(sigma=0.0), own, generator=seeded(1))
    assert same_bits(composed(batch.select(0)), augment.Jitter(generator=seeded(7))(batch.select(0)))


def test_composed_motions_are_their_product(batch):
    first, second = (augment.RandomMotion(generator=seeded(seed)) for seed in (1, 2))
    composed = augment.Compose(*copy.deepcopy([first, second])).tracked(batch.select(0))
    one = first.tracked(batch.select(0))
    two = second.tracked(one.clouds)
    assert same_bits(composed.clouds, two.clouds)
    assert torch.allclose(composed.T_new_old, two.T_new_old @ one.T_new_old, atol=1e-12)


def test_refusals(batch):
    with refuses("probability", "number in [0, 1]"):
        augment.Jitter(probability=1.5)
    with refuses("generator", "torch.Generator"):
        augment.Jitter(generator=5)
    with refuses("members", "at least one"):
        augment.Compose()
    with refuses("members", "Augmentation", "Identity"):
        augment.Compose(torch.nn.Identity())
    with refuses("seeds", "3 numbers"):
        augment.Jitter().tracked(batch, [1])
