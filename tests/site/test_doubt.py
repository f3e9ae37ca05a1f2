"""Links that contradict each other are trusted less, as much as their contradictions say."""

import pytest
import torch
from sites import made_site

from torchreg.site import trust
from torchreg.site.doubt import doubt
from torchreg.site.placement import place
from torchreg.site.tolerance import Tolerance


def doubt_of(site):
    return doubt(site.links, place(site.links, len(site.poses)))


@pytest.mark.parametrize("seed", range(3))
def test_links_of_which_most_are_right_raise_no_doubt(seed):
    assert doubt_of(made_site(30, 120, wrong=0.2, seed=seed)) == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_sure_links_of_which_most_are_wrong_raise_doubt(seed):
    site = made_site(15, 90, wrong=0.8, seed=seed, odds=(2.0, 0.5), wrong_odds=(2.0, 0.5))
    assert doubt_of(site) >= 1.5


def test_more_contradictions_are_more_doubt():
    shares = (0.1, 0.5, 0.9)
    sites = [made_site(15, 90, wrong=share, odds=(2.0, 0.5), wrong_odds=(2.0, 0.5)) for share in shares]
    few, some, many = map(doubt_of, sites)
    assert few <= some <= many
    assert few < many


def test_a_tree_alone_is_no_test():
    site = made_site(12, 60, wrong=0.0)
    tree, joined = [], {0}
    while len(joined) < 12:
        link = next(one for one in site.links if (one.source in joined) != (one.target in joined))
        joined |= {link.source, link.target}
        tree.append(link)
    assert doubt(tree, place(tree, 12)) == 0.0


def test_the_doubt_that_is_told_is_what_was_taken(monkeypatch):
    links = made_site(6, 12, wrong=0.0).links
    monkeypatch.setattr(trust, "doubt", lambda links, placement: 1.0)  # which never ends
    trusted = trust.placed([[link] for link in links], 6, Tolerance())
    assert trusted.doubt > 0
    taken = [link.log_odds - less.log_odds for link, less in zip(links, trusted.links, strict=True)]
    assert taken == pytest.approx([trusted.doubt] * len(links))


def test_nothing_placed_is_no_doubt():
    assert doubt([], place([], 3)) == 0.0
    assert torch.equal(place([], 3).group, torch.full((3,), -1))
