"""The page on a site: what is placed, why the rest is not, tables, and no word of a name as markup."""

from dataclasses import replace

import pytest
import torch
from problems import room_site

import torchreg as tr
from torchreg.report.page.site_report import site_report_html, write_site_report
from torchreg.report.site_text import summary_of


@pytest.fixture(scope="module")
def scans():
    empty = tr.Clouds(torch.zeros(0, 3), colors=torch.zeros(0, 3))
    return [*room_site(3).scans, empty]


@pytest.fixture(scope="module")
def site(scans):
    return tr.register_site(scans, effort="fast")


def test_the_page_tells_scans_links_and_reasons(site, scans):
    page = site_report_html(site, scans)
    assert "3 of 4 scans are placed in one frame" in page
    assert "scan 3 is not placed: too few points" in page
    for heading in ("What to look at first", "The scans in 3D", "Scans", "Links", "Versions"):
        assert f"<h2>{heading}</h2>" in page
    assert page.count('class="viewer"') == 1
    assert page == site_report_html(site, scans)


def test_a_note_stands_once_with_its_scans(site, scans):
    page = site_report_html(replace(site, notes=(("bright",), (), ("bright",), ("dim",))), scans)
    assert page.count("scans 0, 2: bright") == 1
    assert "scans 3: dim" in page


def test_names_are_text(site, scans):
    page = site_report_html(site, scans, names=["<b>a</b>", "b", "c", "d"])
    assert "<b>a</b>" not in page
    assert "&lt;b&gt;a&lt;/b&gt;" in page


def test_a_site_of_which_nothing_is_placed_has_a_page(scans):
    nothing = tr.register_site(scans[3:])
    page = site_report_html(nothing, scans[3:])
    assert "None of 1 scans could be placed" in page
    assert 'class="viewer"' not in page


def test_every_group_has_its_view(site, scans):
    apart = replace(site, group=torch.tensor([0, 0, 1, -1]))
    assert site_report_html(apart, scans).count('class="viewer"') == 2
    assert "2 frames that do not connect, of 2 and 1 scans" in summary_of(apart)


def test_arguments_are_checked(site, scans, tmp_path):
    with pytest.raises(ValueError, match="path: expected a name that ends in"):
        write_site_report(tmp_path / "page.txt", site, scans)
    with pytest.raises(ValueError, match=r"scans: expected one per scan \(4\), got 2"):
        site_report_html(site, scans[:2])
    with pytest.raises(ValueError, match="max_points"):
        site_report_html(site, scans, max_points=0)
