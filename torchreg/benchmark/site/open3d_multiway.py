"""Open3D's multiway registration, put together as its documentation does for scans without a first guess."""

from __future__ import annotations

from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import torch

from torchreg.benchmark.site.method import SiteAnswer, SiteMethod, SiteTask, along_tree, numbered
from torchreg.io import to_open3d
from torchreg.open3d_loader import load_open3d
from torchreg.seeds import open3d_seed
from torchreg.types import Clouds

_HYPOTHESES, _CONFIDENCE = 100_000, 0.999
_EDGE_PRUNED = 0.25  # confidence of the line process below which an edge is dropped, as in the tutorial
_OVERLAP = 0.3  # as in its reconstruction system


class _Edge(NamedTuple):
    """Two scans, registered."""

    source: int
    target: int
    T_target_source: Any  # (4, 4) float64
    information: Any  # (6, 6) float64; the last entry is the number of correspondences


def _multiway(least_overlap: float) -> SiteMethod:
    def run(task: SiteTask) -> SiteAnswer:
        return _place(task, least_overlap)

    all_pairs, overlapping = "of all pairs", f"with at least {least_overlap:.0%} of the smaller scan's points matched"
    kept = overlapping if least_overlap else all_pairs
    return SiteMethod(
        name=f"open3d-{100 * least_overlap:g}" if least_overlap else "open3d",
        title=f"Open3D multiway, overlap {least_overlap:.0%}" if least_overlap else "Open3D multiway",
        statement="Voxels v, normals 2 v / 30 neighbors towards the scanner where it is known, FPFH 5 v / 100; all "
        f"pairs by RANSAC on mutual matches (at most {_HYPOTHESES:,} hypotheses, confidence {_CONFIDENCE:g}, threshold "
        f"1.5 v) and point-to-plane ICP at 1.5 v; edges {kept}, all of them uncertain, with their information "
        "matrices; global optimization by Levenberg-Marquardt with line process, edges pruned below "
        f"{_EDGE_PRUNED:g}, from the tree of most correspondences; groups are what the edges left hold together.",
        run=run,
        slow=least_overlap > 0,
    )


def _place(task: SiteTask, least_overlap: float) -> SiteAnswer:
    o3d = load_open3d()
    o3d.utility.random.seed(open3d_seed(task.seed))
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        return _placed(o3d, task, least_overlap)


def _placed(o3d: Any, task: SiteTask, least_overlap: float) -> SiteAnswer:  # noqa: ANN401  # Open3D itself
    described = [_described(o3d, cloud, task.voxel) for cloud in task.scans]
    edges, tried = [], 0
    for source, target in combinations(range(len(described)), 2):
        tried += 1
        edge = _registered(o3d, described, source, target, 1.5 * task.voxel)
        fewest = min(len(described[source][0].points), len(described[target][0].points))
        if edge is not None and edge.information[5, 5] >= max(least_overlap * fewest, 1):
            edges.append(edge)
    T_world_scan, labels = _optimized(o3d, len(described), edges, 1.5 * task.voxel)
    origins = torch.cat([cloud.origin for cloud in task.scans])
    T_world_scan[:, :3, 3] -= (T_world_scan[:, :3, :3] @ origins[:, :, None])[:, :, 0]
    return SiteAnswer(T_world_scan=T_world_scan, group=numbered(labels), pairs_tried=tried)


def _described(o3d: Any, cloud: Clouds, voxel: float) -> tuple[Any, Any]:  # noqa: ANN401  # Open3D's objects
    """The points of a scan less its origin, thinned, with normals, and their FPFH."""
    registration, search = o3d.pipelines.registration, o3d.geometry.KDTreeSearchParamHybrid
    points = to_open3d(Clouds(points=cloud.points)).voxel_down_sample(voxel)
    points.estimate_normals(search(radius=2 * voxel, max_nn=30))
    if cloud.viewpoint is not None and len(points.points):
        points.orient_normals_towards_camera_location(cloud.viewpoint[0].double().numpy())
    return points, registration.compute_fpfh_feature(points, search(radius=5 * voxel, max_nn=100))


def _registered(o3d: Any, described: list[tuple[Any, Any]], source: int, target: int, threshold: float) -> _Edge | None:  # noqa: ANN401
    registration = o3d.pipelines.registration
    (points, features), (other, other_features) = described[source], described[target]
    if min(len(points.points), len(other.points)) < 3:
        return None
    coarse = registration.registration_ransac_based_on_feature_matching(
        points,
        other,
        features,
        other_features,
        True,
        threshold,
        registration.TransformationEstimationPointToPoint(False),
        3,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
            registration.CorrespondenceCheckerBasedOnDistance(threshold),
        ],
        registration.RANSACConvergenceCriteria(_HYPOTHESES, _CONFIDENCE),
    )
    if len(coarse.correspondence_set) < 3:
        return None
    plane = registration.TransformationEstimationPointToPlane()
    T = registration.registration_icp(points, other, threshold, coarse.transformation, plane).transformation
    information = registration.get_information_matrix_from_point_clouds(points, other, threshold, T)
    return _Edge(source, target, np.array(T), np.array(information))


def _optimized(o3d: Any, count: int, edges: list[_Edge], threshold: float) -> tuple[torch.Tensor, list[int]]:  # noqa: ANN401
    """Poses (N, 4, 4), and for each scan a label of what the edges left hold together."""
    registration = o3d.pipelines.registration
    surest = sorted(edges, key=lambda edge: (-edge.information[5, 5], edge.source, edge.target))
    links = [(edge.source, edge.target, torch.from_numpy(edge.T_target_source)) for edge in surest]
    graph = registration.PoseGraph()
    for T in along_tree(count, links).T_world_scan.numpy():
        graph.nodes.append(registration.PoseGraphNode(T))
    for edge in edges:
        graph.edges.append(registration.PoseGraphEdge(*edge, uncertain=True))
    if edges:
        registration.global_optimization(
            graph,
            registration.GlobalOptimizationLevenbergMarquardt(),
            registration.GlobalOptimizationConvergenceCriteria(),
            registration.GlobalOptimizationOption(
                max_correspondence_distance=threshold, edge_prune_threshold=_EDGE_PRUNED, reference_node=0
            ),
        )
    labels = list(range(count))
    for edge in graph.edges:
        old, new = labels[edge.source_node_id], labels[edge.target_node_id]
        labels = [new if label == old else label for label in labels]
    return torch.from_numpy(np.stack([node.pose for node in graph.nodes])), labels


SITE_METHODS = (_multiway(0.0), _multiway(_OVERLAP))
