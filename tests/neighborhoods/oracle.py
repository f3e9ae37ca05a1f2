"""All pairs of a cloud, sorted: what every search must return."""

import torch

from torchreg.types.packing import spans


def all_pairs(points, offsets, limits, max_neighbors):
    """index, valid and sq_distance of a hybrid search; ``limits`` are squared radii in the dtype of the points."""
    rows = len(points)
    index = torch.arange(rows)[:, None].repeat(1, max_neighbors)
    valid = torch.zeros(rows, max_neighbors, dtype=torch.bool)
    sq_distance = torch.zeros(rows, max_neighbors, dtype=points.dtype)
    for (begin, end), limit in zip(spans(offsets), limits, strict=True):
        for row in range(begin, end):
            x, y, z = (points[begin:end] - points[row]).unbind(1)
            squares = x * x + y * y + z * z
            order = squares.argsort(stable=True)
            order = order[squares[order] < limit][:max_neighbors]
            index[row, : len(order)] = order + begin
            valid[row, : len(order)] = True
            sq_distance[row, : len(order)] = squares[order]
    return index, valid, sq_distance
