"""From two clouds to a pose loss, with gradients back to everything that stands on the way."""

from dataclasses import replace

import pytest
import torch
from closeness import close
from problems import room_pair
from refusals import refuses

import torchreg as tr
from torchreg.learning import pose_loss
from torchreg.matching.soft import soft_targets

ROOM = room_pair(700, seed=3)
OPTIONS = tr.RegistrationOptions(
    normal_radius=1.0, feature_radius=2.0, color_radius=1.5, ransac=tr.RansacOptions(inlier_threshold=0.6)
)
MATCHERS = {
    "dual softmax": {},
    "dual softmax without a dustbin": {"dustbin": None},
    "sinkhorn": {"method": "sinkhorn", "iterations": 20},
}


def asking(cloud):
    """The same cloud, asking for gradients of points and colors."""
    return replace(cloud, points=cloud.points.clone().requires_grad_(), colors=cloud.colors.clone().requires_grad_())


def features(cloud, fuse):
    near = tr.neighbors(cloud, 2.0, 60)
    cloud = tr.estimate_normals(cloud, near.restrict(1.0, 30))
    return fuse(tr.nn.FPFH()(cloud, near), tr.nn.PCFH()(cloud, near))


@pytest.mark.parametrize("words", MATCHERS.values(), ids=MATCHERS)
def test_step_by_step_gradients_reach_block_weights_temperature_dustbin_and_points(words):
    fuse, match, solve = tr.nn.Fuse(), tr.nn.SoftMatch(**words), tr.nn.WeightedKabsch(rounds=3, scale=0.6)
    source, target = asking(ROOM.source), asking(ROOM.target)
    T = solve(source, target, match(features(source, fuse), features(target, fuse)))
    loss = pose_loss(T, ROOM.T_target_source)
    assert loss.rotation.rad2deg() < 5
    assert loss.translation < 0.5
    loss.total.sum().backward()
    leaves = [source.points, target.points, source.colors, target.colors, *fuse.parameters(), *match.parameters()]
    for leaf in leaves:
        assert torch.isfinite(leaf.grad).all()
        assert leaf.grad.any()


def test_the_module_is_these_steps():
    module = tr.nn.Register(OPTIONS, solve=tr.nn.WeightedKabsch())
    found = module(ROOM.source, ROOM.target)
    partners = soft_targets(found.matches, found.target.points)
    T = tr.kabsch(found.source.points, partners.points, partners.weights)
    assert close(found.T_target_source[0], T.double(), atol=1e-4)
    fused = tr.fuse(*(
        tr.Features(found.source_features.block(name), found.source_features.offsets, ((name, size),),
                    found.source_features.valid) for name, size in (("fpfh", 33), ("pcfh", 11))
    ))  # fmt: skip
    assert close(fused.values, found.source_features.values, atol=1e-5)


def test_rounds_bring_the_pose_nearer_to_the_truth():
    modules = [
        tr.nn.Register(OPTIONS, solve=solve) for solve in (tr.nn.WeightedKabsch(), tr.nn.WeightedKabsch(rounds=5))
    ]
    poses = [module(ROOM.source, ROOM.target).T_target_source for module in modules]
    errors = [float(pose_loss(T, ROOM.T_target_source).total.detach()) for T in poses]
    assert errors[1] < 0.5 * errors[0]


def test_a_few_steps_of_training_lower_the_loss():
    module = tr.nn.Register(OPTIONS, solve=tr.nn.WeightedKabsch(rounds=1))
    optimizer = torch.optim.Adam(module.parameters(), lr=0.05)
    losses = []
    for _ in range(6):
        loss = pose_loss(module(ROOM.source, ROOM.target).T_target_source, ROOM.T_target_source).total.sum()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.9 * losses[0]


@pytest.mark.parametrize("derived", [False, True])
def test_a_batch_is_the_loop_over_its_pairs(derived):
    other = room_pair(400, seed=5, scale=1.5)
    module = tr.nn.Register(None if derived else OPTIONS)
    whole = module(tr.Clouds.pack([ROOM.source, other.source]), tr.Clouds.pack([ROOM.target, other.target]))
    for b, pair in enumerate((ROOM, other)):
        alone = module(pair.source, pair.target)
        assert torch.equal(alone.matches.confidence[0], whole.matches.confidence[b])
        assert close(alone.T_target_source[0], whole.T_target_source[b], atol=1e-5)


def test_origins_are_part_of_the_pose():
    shift = torch.tensor([[4e6, -3e5, 120.0]], dtype=torch.float64)
    module = tr.nn.Register(OPTIONS)
    plain = module(ROOM.source, ROOM.target).T_target_source
    moved = module(replace(ROOM.source, origin=shift), replace(ROOM.target, origin=2 * shift)).T_target_source
    place = torch.rand(5, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    at = place @ plain[0, :3, :3].t() + plain[0, :3, 3] + 2 * shift
    assert close((place + shift) @ moved[0, :3, :3].t() + moved[0, :3, 3], at, atol=1e-6)


def test_what_was_learned_serves_the_hard_pipeline():
    found = tr.nn.Register(OPTIONS).requires_grad_(False)(ROOM.source, ROOM.target)
    matches = tr.match_mutual(found.source_features, found.target_features)
    result = tr.ransac(found.source, found.target, matches, OPTIONS.ransac)
    assert pose_loss(result.T_target_source, ROOM.T_target_source).translation < 0.5


def test_options_decide_descriptors_and_weights():
    options = replace(OPTIONS, color_weights=(0.4,), color_bins=7, equalization="joint", voxel_size=0.5, root=0.3)
    module = tr.nn.Register(options)
    assert module.fuse.weights.tolist() == pytest.approx([1.0, 0.4])
    assert module.fuse.root == 0.3
    found = module(ROOM.source, ROOM.target)
    assert found.source_features.blocks == (("fpfh", 33), ("pcfh", 7))
    assert len(found.source.points) == len(tr.voxel_downsample(ROOM.source, 0.5).points)
    separate = tr.nn.Register(replace(options, equalization="cloud"))(ROOM.source, ROOM.target)
    assert not torch.equal(found.source_features.values, separate.source_features.values)
    colorless = replace(ROOM.source, colors=None), replace(ROOM.target, colors=None)
    assert tr.nn.Register(replace(OPTIONS, color=(), color_weights=()))(*colorless).source_features.blocks == (
        ("fpfh", 33),
    )
    geometry = tr.nn.Register(OPTIONS, descriptors=[tr.nn.FPFH(learn_edges=True)])
    assert geometry(*colorless).T_target_source.requires_grad


def test_bad_arguments_are_refused():
    with refuses("options.descriptors", "Pcfh"):
        tr.nn.Register(replace(OPTIONS, color=("contrast",)))
    with refuses("descriptors", "at least one"):
        tr.nn.Register(descriptors=[])
    with refuses("target", "1 clouds"):
        tr.nn.Register(OPTIONS)(ROOM.source, tr.Clouds.pack([ROOM.target, ROOM.target]))
    with pytest.raises(ValueError, match="cloud: expected colors"):
        tr.nn.Register(OPTIONS)(replace(ROOM.source, colors=None), ROOM.target)


def test_every_module_has_the_support_of_its_own_record():
    pair = room_pair(300)
    two = tr.RegistrationOptions(normal_radius=0.6, descriptors=(tr.Fpfh(radius=1.0), tr.Fpfh(radius=2.0)))
    values = tr.nn.Register(two)(pair.source, pair.target).source_features.values
    for block, radius in ((values[:, :33], 1.0), (values[:, 33:], 2.0)):
        one = tr.RegistrationOptions(normal_radius=0.6, descriptors=(tr.Fpfh(radius=radius),))
        alone = tr.nn.Register(one)(pair.source, pair.target).source_features.values
        assert torch.allclose(block, alone)


class Heights(torch.nn.Module):
    """A descriptor of one's own, as a tensor or as features."""

    def __init__(self, tensor):
        super().__init__()
        self.tensor, self.layer = tensor, torch.nn.Linear(33, 8)

    def forward(self, cloud, near):
        values = self.layer(tr.fpfh(cloud, near).values)
        valid = torch.ones(len(values), dtype=torch.bool)
        return values if self.tensor else tr.Features(values, cloud.offsets, (("mine", 8),), valid)


def test_modules_of_ones_own_describe_beside_the_librarys():
    torch.manual_seed(0)
    mine = Heights(tensor=True)
    module = tr.nn.Register(OPTIONS, descriptors=[mine, tr.nn.PCFH()])
    found = module(ROOM.source, ROOM.target)
    assert found.source_features.blocks == (("descriptors[0]", 8), ("pcfh", 11))
    pose_loss(found.T_target_source, ROOM.T_target_source).total.sum().backward()
    assert torch.isfinite(mine.layer.weight.grad).all()
    assert mine.layer.weight.grad.any()
    mine.tensor = False
    again = module(ROOM.source, ROOM.target)
    assert again.source_features.blocks == (("mine", 8), ("pcfh", 11))
    assert torch.equal(again.T_target_source, found.T_target_source)


def test_what_a_module_of_ones_own_returns_is_checked():
    class Wrong(torch.nn.Module):
        def forward(self, cloud, near):
            return self.answer(cloud)

    wrong = Wrong()
    module = tr.nn.Register(OPTIONS, descriptors=[wrong])
    for answer, parts in (
        (lambda cloud: cloud.points[1:], ["D)", "3)"]),
        (lambda cloud: cloud.points.long(), ["floating-point", "int64"]),
        (lambda cloud: None, ["a tensor", "NoneType"]),
    ):
        wrong.answer = answer
        with refuses("descriptors[0]", *parts):
            module(ROOM.source, ROOM.target)


def test_features_beyond_the_dustbin_show_in_the_confidence_and_have_no_gradient():
    """What the documentation tells of features on a scale of their own."""
    cloud = tr.Clouds(ROOM.source.points)
    count = len(cloud.points)
    percent = (100 * torch.rand(count, 33)).requires_grad_()
    rows = tr.Features(percent, cloud.offsets, (("mine", 33),), torch.ones(count, dtype=torch.bool))
    other = replace(rows, values=100 * torch.rand(count, 33))
    matches = tr.nn.SoftMatch()(rows, other)
    T = tr.nn.WeightedKabsch()(cloud, cloud, matches)
    T.sum().backward()
    assert torch.isfinite(T).all()
    assert float(matches.confidence[0].detach().sum()) == 0
    assert not percent.grad.any()


def test_a_pair_with_an_empty_cloud_has_a_finite_pose_and_no_confidence():
    empty = tr.Clouds(torch.zeros(0, 3))
    rows = tr.Features(torch.zeros(0, 4), empty.offsets, (("mine", 4),), torch.zeros(0, dtype=torch.bool))
    cloud = tr.Clouds(ROOM.target.points)
    count = len(cloud.points)
    other = tr.Features(torch.rand(count, 4), cloud.offsets, (("mine", 4),), torch.ones(count, dtype=torch.bool))
    matches = tr.soft_match(rows, other)
    assert torch.isfinite(tr.nn.WeightedKabsch()(empty, cloud, matches)).all()
    assert float(matches.confidence[0].detach().sum()) == 0
