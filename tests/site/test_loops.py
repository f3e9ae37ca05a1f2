"""Triangles that agree: those that a plain loop over all threes of links finds, whatever the pieces."""

import math
from itertools import combinations

import pytest
import torch
from closeness import close
from sites import made_site

from torchreg.geometry.se3 import compose, inverse
from torchreg.geometry.small_motions import rotation_vector
from torchreg.site import Tolerance, loops
from torchreg.site.graph import site_graph
from torchreg.site.loops import agreeing_triangles, error_scale, support


def plain_triangles(graph, tolerance):
    """The rows of links (i, j), (j, k), (i, k) whose loop closes within three degrees and 0.3 m and some noise."""
    turn_variance, shift_variance = tolerance.variances(graph)
    ends = list(zip(graph.first.tolist(), graph.second.tolist(), strict=True))
    found = {}
    for three in combinations(range(len(graph)), 3):
        nodes = sorted({node for row in three for node in ends[row]})
        if len(nodes) != 3 or len({ends[row] for row in three}) != 3:
            continue
        i, j, k = nodes
        by_ends = {ends[row]: row for row in three}
        a, b, c = by_ends[i, j], by_ends[j, k], by_ends[i, k]
        D = compose(compose(graph.T[a], graph.T[b]), inverse(graph.T[c]))
        center = graph.center[c]
        turn = float(rotation_vector(D[:3, :3]).norm())
        shift = float((D[:3, :3] @ center + D[:3, 3] - center).norm())
        lever = float(graph.T[c, :3, 3].square().sum() * (turn_variance[a] + turn_variance[b]))
        turns = math.radians(3) ** 2 + 9 * float(turn_variance[[a, b, c]].sum())
        shifts = 0.3**2 + 9 * (float(shift_variance[[a, b, c]].sum()) + lever)
        if turn**2 <= turns and shift**2 <= shifts:
            found[a, b, c] = (turn, shift)
    return found


@pytest.mark.parametrize("seed", range(3))
def test_they_are_those_of_a_plain_loop(seed, monkeypatch):
    site = made_site(12, 36, 0.3, seed)
    graph, tolerance = site_graph(site.links, (), 12), Tolerance()
    expected = plain_triangles(graph, tolerance)
    assert len(expected) > 3
    for wedges in (1 << 18, 3):
        monkeypatch.setattr(loops, "_WEDGES", wedges)
        triangles = agreeing_triangles(graph, tolerance)
        assert [tuple(row) for row in triangles.links.tolist()] == sorted(expected)
        values = torch.tensor([expected[tuple(row)] for row in triangles.links.tolist()], dtype=torch.float64)
        assert close(torch.stack([triangles.turn, triangles.shift], dim=1), values, 1e-12)


def test_support_counts_triangles_by_the_probability_of_the_others():
    site = made_site(12, 36, 0.0)
    graph = site_graph(site.links, (), 12)
    triangles = agreeing_triangles(graph, Tolerance())
    probability = torch.linspace(0.1, 0.9, 36, dtype=torch.float64)
    expected = torch.zeros(36, dtype=torch.float64)
    for three in triangles.links.tolist():
        for row in three:
            expected[row] += probability[three].prod() / probability[row]
    assert close(support(triangles, probability), expected, 1e-12)


def test_a_pair_twice_makes_no_triangle_with_itself():
    site = made_site(3, 3, 0.0)
    graph = site_graph([site.links[0], site.links[0], site.links[1]], (), 3)
    assert len(agreeing_triangles(graph, Tolerance()).turn) == 0


def test_triangles_tell_how_large_errors_are():
    site = made_site(20, 90, 0.0)
    graph = site_graph(site.links, (), 20)
    triangles = agreeing_triangles(graph, Tolerance())
    assert 1 <= error_scale(graph, triangles) < 1.5
    graph.covariance.div_(25)
    assert 12 < error_scale(graph, triangles) < 40
