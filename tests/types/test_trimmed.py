"""Slots that no row uses can go."""

import torch
from problems import room_pair

import torchreg as tr


def test_trimming_keeps_every_neighbor_and_no_empty_column():
    scan = room_pair(300).source
    near = tr.neighbors(scan, 0.6, 80)
    trimmed = near.trimmed()
    assert trimmed.max_neighbors == int(near.counts().max()) < 80
    assert torch.equal(trimmed.counts(), near.counts())
    assert torch.equal(tr.pcfh(scan, trimmed).values, tr.pcfh(scan, near).values)


def test_an_empty_neighborhood_keeps_one_slot():
    empty = tr.neighbors(tr.Clouds(points=torch.zeros(0, 3)), 1.0, 5)
    assert empty.trimmed().max_neighbors == 1
