"""The picture of the matches: lines at the right places, inliers and outliers distinct, any clouds drawn."""

import io
from dataclasses import replace

import numpy as np
import pytest
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from problems import correspondence_problem, random_transform, room_pair
from refusals import refuses
from results import bare_result

import torchreg as tr
from torchreg.report import correspondence_figure, registration_figure
from torchreg.report.correspondences import INLIER_COLOR, OUTLIER_COLOR, MatchEnds, drawn_matches, match_ends
from torchreg.report.scene import scene_of
from torchreg.report.views import layout_of

PLAIN = tr.RegistrationOptions(
    normal_radius=0.3, feature_radius=0.6, color_radius=0.5, ransac=tr.RansacOptions(inlier_threshold=0.15)
)


@pytest.fixture(scope="module")
def registered():
    """Two pairs as one batch, the first refused, and their result; the rows are those of voxel means."""
    pair = room_pair(4000, seed=1)
    line = tr.Clouds(points=torch.linspace(0, 1, 50)[:, None] * torch.ones(3), colors=torch.rand(50, 3))
    source, target = tr.Clouds.pack([line, pair.source]), tr.Clouds.pack([line, pair.target])
    result = tr.register(source, target, replace(PLAIN, voxel_size=0.1))
    assert result.success.tolist() == [False, True]
    return source, target, result


@pytest.fixture(scope="module")
def solved():
    """Matches with known inliers, solved by ``ransac`` on the clouds as they are."""
    problem = correspondence_problem(400, 0.5, seed=2)
    options = tr.RansacOptions(inlier_threshold=0.1)
    generator = torch.Generator().manual_seed(0)
    result = tr.ransac(problem.source, problem.target, problem.matches, options, generator=generator)
    assert bool(result.success[0])
    return problem, result


def lines_of(figure):
    """Line segments (L, 2, 2) by color."""
    parts = [part for part in figure.axes[0].collections if isinstance(part, LineCollection)]
    return {to_hex(part.get_colors()[0]): np.array(part.get_segments()).reshape(-1, 2, 2) for part in parts}


def labels_of(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


@pytest.mark.parametrize("voxel_size", [None, 0.1])
def test_rows_are_those_of_the_clouds_that_were_matched(registered, voxel_size):
    """The transform brings every inlier within the threshold, and no other match."""
    source, target = (cloud.select(1) for cloud in registered[:2])
    result = tr.register(source, target, replace(PLAIN, voxel_size=voxel_size))
    ends = match_ends(result, 0)
    np.testing.assert_array_equal(ends.source, result.source.points[result.correspondences.source].double())
    if voxel_size is not None:
        means = tr.voxel_downsample(source, voxel_size).points[result.correspondences.source]
        np.testing.assert_array_equal(ends.source, means.double())
    T = result.T_target_source[0].numpy()
    apart = np.linalg.norm(ends.source @ T[:3, :3].T + T[:3, 3] - ends.target, axis=1)
    wrong = (apart < PLAIN.ransac.inlier_threshold) != ends.inlier
    assert wrong.sum() <= 0.1 * ends.inlier.sum()
    assert ends.inlier.sum() > 30


def test_rows_of_a_batch_with_a_refused_pair(registered):
    source, target, result = registered
    alone = tr.register(source.select(1), target.select(1), result.options[1])
    one, other = match_ends(result, 1), match_ends(alone, 0)
    for name in MatchEnds._fields:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert len(match_ends(result, 0).inlier) == 0


def test_rows_of_a_solver_are_those_of_the_clouds_as_they_are(solved):
    problem, result = solved
    ends = match_ends(result, 0)
    np.testing.assert_array_equal(ends.source, problem.source.points[problem.matches.source].numpy())
    np.testing.assert_array_equal(ends.target, problem.target.points[problem.matches.target].numpy())
    np.testing.assert_array_equal(ends.inlier, problem.is_inlier.numpy())


def test_lines_of_inliers_are_parallel_and_those_of_outliers_are_not(solved):
    problem, result = solved
    lines = lines_of(correspondence_figure(problem.source, problem.target, result, max_matches=200))
    assert set(lines) == {INLIER_COLOR, OUTLIER_COLOR}
    steps = {color: drawn[:, 1] - drawn[:, 0] for color, drawn in lines.items()}
    assert steps[INLIER_COLOR].std(axis=0).max() < 0.1 < steps[OUTLIER_COLOR].std(axis=0).max()
    assert np.linalg.norm(steps[INLIER_COLOR].mean(axis=0)) > 10  # the size of the clouds


def test_the_legend_counts_all_and_says_how_many_are_drawn(solved):
    problem, result = solved
    figure = correspondence_figure(problem.source, problem.target, result, max_matches=40, title="a title")
    assert labels_of(figure) == ["inliers: 200 of 400 (50 %), 20 drawn", "outliers: 200 of 400 (50 %), 20 drawn"]
    assert [len(drawn) for drawn in lines_of(figure).values()] == [20, 20]
    all_of_them = correspondence_figure(problem.source, problem.target, result, max_matches=1000)
    assert labels_of(all_of_them)[0] == "inliers: 200 of 400 (50 %)"
    assert figure.get_suptitle() == "a title"
    assert isinstance(figure.canvas, FigureCanvasAgg)
    assert all("(m)" in label for label in (figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()))


@pytest.mark.parametrize("inliers", [0, 1, 5, 500, 995, 1000])
@pytest.mark.parametrize("count", [1, 2, 50, 2000])
def test_thinning_keeps_both_kinds_and_their_shares(inliers, count):
    generator = np.random.default_rng(0)
    points = generator.random((1000, 3))
    ends = MatchEnds(points, points, np.arange(1000) < inliers)
    inlier, outlier = drawn_matches(ends, count)
    assert ends.inlier[inlier].all()
    assert not ends.inlier[outlier].any()
    assert len(inlier) + len(outlier) == min(count, 1000)
    assert len(set(inlier)) + len(set(outlier)) == min(count, 1000)
    if count == 50:
        assert len(inlier) >= min(inliers, 10)
        assert len(outlier) >= min(1000 - inliers, 10)
    if (inliers, count) == (500, 50):
        assert len(inlier) == 25


@pytest.mark.parametrize("success", [True, False])
def test_the_clouds_stand_apart(registered, success):
    source, target, result = registered
    scene = scene_of(source.select(1), target.select(1), 2000)
    placed = scene.moved(result.T_target_source[1]) if success else scene.source
    layout = layout_of(placed, scene)
    shifted = (placed + layout.shift)[:, layout.axis]
    target_along = scene.target[:, layout.axis]
    assert shifted.max() < np.quantile(target_along, 0.01) or shifted.min() > np.quantile(target_along, 0.99)
    assert np.count_nonzero(layout.shift) == 1


def camera_cloud():
    """A wall as a camera saw it that looks along z with y down: green below, red above."""
    points = (torch.rand(2000, 3, generator=torch.Generator().manual_seed(0)) - 0.5) * torch.tensor([4.0, 2, 0.1])
    points = points + torch.tensor([0.0, 0, 3])
    colors = torch.stack((points[:, 1] < 0, points[:, 1] >= 0, torch.zeros(2000) > 0), dim=1).float()
    return tr.Clouds(points=points, colors=colors, viewpoint=torch.zeros(1, 3))


def test_a_camera_sees_what_it_saw():
    """As in its image: what has a larger y is lower, what has a larger x is on the right."""
    cloud = camera_cloud()
    layout = layout_of(cloud.points.double().numpy(), scene_of(cloud, cloud, 2000))
    assert layout.view.name == "front"
    ax = correspondence_figure(cloud, cloud, bare_result()).axes[0]
    assert not ax.yaxis_inverted()
    assert not ax.xaxis_inverted()
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x (m)", "-y (m)")
    assert ax.get_title().startswith("front view, along z;")
    drawn, colors = ax.collections[0].get_offsets(), ax.collections[0].get_facecolors()
    red = colors[:, 0] > colors[:, 1] + 0.1
    assert red.mean() == pytest.approx(0.5, abs=0.1)
    target = drawn[:, 0] > -2.5  # the source stands to its left or above it
    assert drawn[red & target][:, 1].mean() > drawn[~red & target][:, 1].mean()


def test_a_plan_is_drawn_from_above_although_the_scanner_stood_low():
    """A scanner two meters above a wide floor: x to the right and y up, as in a plan, and not in a mirror."""
    points = torch.rand(4000, 3, generator=torch.Generator().manual_seed(0)) * torch.tensor([40.0, 30, 0.1])
    posts = torch.rand(400, 3, generator=torch.Generator().manual_seed(1)) * torch.tensor([40.0, 30, 9])
    middle = torch.tensor([20.0, 15, 1.7])
    cloud = tr.Clouds(points=torch.cat((points, posts)) - middle, viewpoint=torch.zeros(1, 3))
    ax = correspondence_figure(cloud, cloud, bare_result()).axes[0]
    assert ax.get_title().startswith("top view, along -z;")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x (m)", "y (m)")
    assert not ax.yaxis_inverted()
    assert not ax.xaxis_inverted()


def test_both_pictures_have_one_frame(registered):
    source, target, _ = registered
    camera = camera_cloud()
    for one, other in ((source.select(1), target.select(1)), (camera, camera)):
        views = registration_figure(one, other, torch.eye(4)).axes
        here = correspondence_figure(one, other, bare_result()).axes[0]
        labels = {label for ax in views for label in (*ax.get_ylabel().splitlines(), ax.get_xlabel())}
        assert {here.get_xlabel(), here.get_ylabel()} <= labels


def test_a_pair_without_a_pose_is_drawn_as_it_came(registered):
    source, target, result = registered
    figure = correspondence_figure(source, target, result, 0)
    figure.canvas.draw()
    assert labels_of(figure) == ["inliers: 0 of 0", "outliers: 0 of 0"]
    assert "as it came, since no pose was found" in figure.axes[0].get_title()
    failed = replace(result, success=torch.tensor([False, False]), inliers=torch.zeros_like(result.inliers))
    refused = correspondence_figure(source, target, failed, 1)
    assert len(lines_of(refused)[OUTLIER_COLOR]) == 120
    assert "the likeliest transform, which was refused" in refused.axes[0].get_title()


@pytest.mark.parametrize("colored", [True, False])
@pytest.mark.parametrize("count", [4, 5000])
def test_whatever_comes_is_drawn(count, colored):
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(count, 3, generator=generator)
    points[1] = points[0]
    colors = torch.rand(count, 3, generator=generator) if colored else None
    cloud = tr.Clouds(points=points, colors=colors)
    figure = correspondence_figure(cloud, cloud, bare_result())
    figure.canvas.draw()
    assert labels_of(figure) == ["inliers: 3 of 4 (75 %)", "outliers: 1 of 4 (25 %)"]


def test_clouds_far_from_their_zero(registered):
    source, target = (cloud.select(1) for cloud in registered[:2])
    result = tr.register(source, target, PLAIN)
    origin = torch.tensor([[4.5e5, 5.4e6, 300.0]], dtype=torch.float64)
    far, matched = replace(target, origin=origin), replace(result.target, origin=origin)
    T = result.T_target_source.clone()
    T[:, :3, 3] += origin[0]
    moved = correspondence_figure(source, far, replace(result, T_target_source=T, target=matched))
    for color, lines in lines_of(correspondence_figure(source, target, result)).items():
        np.testing.assert_allclose(lines_of(moved)[color], lines, atol=1e-6)
    assert " - 450000 (m)" in moved.axes[0].get_xlabel() + moved.axes[0].get_ylabel()


def test_the_same_clouds_give_the_same_picture(solved):
    problem, result = solved

    def drawn():
        buffer = io.BytesIO()
        correspondence_figure(problem.source, problem.target, result).savefig(buffer, format="png", dpi=40)
        return buffer.getvalue()

    assert drawn() == drawn()


def test_refusals(solved):
    problem, result = solved
    source, target = problem.source, problem.target
    with refuses("source", "the 1 clouds that were registered", "2 clouds"):
        correspondence_figure(tr.Clouds.pack([source, source]), target, result)
    for pair in (-1, 1):
        with refuses("pair", "a number from 0 to 0"):
            correspondence_figure(source, target, result, pair)
    with refuses("max_matches", "0"):
        correspondence_figure(source, target, result, max_matches=0)
    with refuses("max_points", "0"):
        correspondence_figure(source, target, result, max_points=0)
    elsewhere = replace(target, origin=target.origin + 1)
    with refuses("target", "clouds that were registered", "other origins"):
        correspondence_figure(source, elsewhere, result)


def test_titles_are_not_taken_for_formulas(solved):
    problem, result = solved
    figure = correspondence_figure(problem.source, problem.target, result, title="$\\nonsense$ a_$.ply \udcff\x1b")
    figure.canvas.draw()


def test_a_transform_that_is_not_the_true_one_shows():
    """Under another transform the same inliers are no longer parallel: the picture is that of the result."""
    problem = correspondence_problem(300, 0.2, seed=3)
    generator = torch.Generator().manual_seed(0)
    wrong = bare_result(
        T_target_source=random_transform(generator)[None],
        inliers=problem.is_inlier,
        correspondences=problem.matches,
        source=problem.source,
        target=problem.target,
    )
    steps = lines_of(correspondence_figure(problem.source, problem.target, wrong))[INLIER_COLOR]
    assert (steps[:, 1] - steps[:, 0]).std(axis=0).max() > 1
