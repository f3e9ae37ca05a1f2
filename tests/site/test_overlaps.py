"""Scans that see the same surfaces are told from those that stand on two sides of one wall."""

import torch
from rooms import rooms

from torchreg.refinement.surfels import surfels_of
from torchreg.site.overlaps import filled_cells, overlapping


def cells_of(made, *, faced):
    surfels = [surfels_of(scan, 20_000) for scan in made.scans]
    return [
        filled_cells(each.cloud.points.double(), each.cloud.normals, T, 0.5, faced=faced)
        for each, T in zip(surfels, made.poses, strict=True)
    ]


def test_scans_of_doors_overlap_with_both_rooms_and_rooms_that_are_not_neighbors_do_not():
    pairs = overlapping(cells_of(rooms(3, 6000), faced=True))
    assert {(0, 1), (1, 2), (2, 3), (3, 4)} <= set(pairs)
    assert (0, 4) not in pairs
    assert pairs == sorted(pairs)


def test_a_wall_between_two_rooms_is_shared_only_where_sides_are_not_known():
    made = rooms(2, 6000)
    front, back = torch.zeros(200, 3).double(), torch.tensor([1.0, 0.0, 0.0]).repeat(200, 1)
    front[:, 1:] = 6 * torch.rand(200, 2, generator=torch.Generator().manual_seed(0)).double()
    eye = made.poses.new_zeros(4, 4).fill_diagonal_(1.0)
    for faced, expected in ((True, []), (False, [(0, 1)])):
        cells = [filled_cells(front, side * back, eye, 0.5, faced=faced) for side in (1, -1)]
        assert overlapping(cells) == expected


def test_the_pairs_that_share_most_stay_and_empty_scans_have_none():
    cells = cells_of(rooms(3, 6000), faced=True)
    every, few = overlapping(cells), overlapping(cells, most=1)
    assert set(few) < set(every)
    assert {scan for pair in few for scan in pair} == set(range(5))
    empty = filled_cells(torch.zeros(0, 3).double(), torch.zeros(0, 3), torch.eye(4).double(), 0.5, faced=True)
    assert overlapping([*cells, empty]) == every
    assert overlapping([]) == []
