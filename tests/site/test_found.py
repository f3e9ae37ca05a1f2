"""What registering a pair found, as links."""

import math
from dataclasses import replace

import pytest
import torch
from problems import room_pair, turned

import torchreg as tr
from torchreg.site.found import has_chance, links_of, weighed, with_odds
from torchreg.site.links import Link, loose_covariance


@pytest.fixture(scope="module")
def result():
    pair = room_pair(3000)
    return tr.register(pair.source, pair.target)


def link(log_odds, residual=math.nan):
    return Link(
        target=0,
        source=1,
        T_target_source=torch.eye(4, dtype=torch.float64),
        log_odds=log_odds,
        probability=0.5,
        covariance=loose_covariance(0.1, 1.0),
        residual=residual,
    )


def test_every_candidate_is_a_link_and_the_best_has_the_refined_pose(result):
    links = links_of(result, 0, 7, 3)
    assert [(one.target, one.source) for one in links] == [(3, 7)] * len(links)
    assert [one.rank for one in links] == list(range(len(links)))
    assert len(links) > 1
    assert torch.equal(links[0].T_target_source, result.T_target_source[0])
    assert torch.equal(links[0].covariance, result.covariance[0])
    for one, candidate in zip(links[1:], result.candidates[0][1:], strict=False):
        assert torch.equal(one.T_target_source, candidate.T_target_source)
        assert math.isnan(one.residual)


def test_a_refused_pair_keeps_its_candidates_and_its_reason(result):
    failure = tr.Failure("ambiguous", "ambiguous: a second pose agrees")
    refused = replace(result, success=torch.tensor([False]), failure=(failure,))
    links = links_of(refused, 0, 1, 0)
    assert len(links) == len(links_of(result, 0, 1, 0))
    assert links[0].reason == failure.text
    assert torch.equal(links[0].T_target_source, result.candidates[0][0].T_target_source)


def test_a_pair_that_no_rigid_pose_joins_has_no_links(result):
    none = tuple(candidate._replace(probability=0.0) for candidate in result.candidates[0])
    assert links_of(replace(result, candidates=(none,)), 0, 1, 0) == []


def test_what_could_be_refined_is_likelier(result):
    before = [link(1.0), link(1.0, residual=0.002), link(-3.0)]
    after = weighed(before)
    assert after[1].log_odds > after[0].log_odds > after[2].log_odds
    assert sum(one.probability for one in after) < 1
    assert [has_chance(one) for one in before] == [True, False, False]


def test_probabilities_share_what_none_leaves():
    one, other = with_odds([link(0.0), link(0.0)], [math.log(2), math.log(2)])
    assert one.probability == other.probability == pytest.approx(2 / 5)


def test_links_do_not_depend_on_where_the_frames_are(result):
    moved = replace(result, source=tr.transform(result.source, turned(40, translation=(1e5, 2e5, 30.0))))
    here, there = links_of(result, 0, 1, 0), links_of(moved, 0, 1, 0)
    torch.testing.assert_close(here[1].covariance, there[1].covariance, rtol=1e-4, atol=0)
