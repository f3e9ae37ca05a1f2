"""Clouds and neighborhoods on which compiled kernels could go wrong: ragged, degenerate, with holes, or views."""

from collections.abc import Callable

import torch
from determinism import same_bits, threads

import torchreg as tr
from torchreg.native import native_kernels


def same_both_ways(run: Callable[[], object]) -> bool:
    """Whether torch and the kernels, with any number of threads, give the same bits."""
    with native_kernels(False):
        expected = run()
    equal = []
    for number in (1, 2, 3):
        with threads(number):
            equal.append(same_bits(run(), expected))
    return all(equal)


def cloud_of(count: int, seed: int = 0, dtype: torch.dtype = torch.float32) -> tr.Clouds:
    """Colored points with unit normals; among them duplicates, a plane, a line, opposite and zero normals."""
    g = torch.Generator().manual_seed(seed)
    points, colors, normals = (torch.rand(count, 3, generator=g, dtype=dtype) for _ in range(3))
    normals = torch.nn.functional.normalize(normals - 0.5, dim=1)
    plane, line, same = (slice(count * i // 8, count * (i + 1) // 8) for i in range(3))
    points[plane, 2] = 0.5
    normals[plane] = torch.tensor([0.0, 0, 1], dtype=dtype)
    points[line, 1:] = 0.25
    normals[line] = torch.where(torch.rand(len(normals[line]), 1, generator=g) < 0.5, -1, 1) * normals[:1]
    points[same] = points[:1]
    normals[count - count // 8 :] = 0
    colors[same] = 0.5  # gray
    colors[count - count // 8 :, 1:] = 0
    return tr.Clouds(points=points, colors=colors, normals=normals)


def supports(cloud: tr.Clouds, seed: int = 0) -> dict[str, tr.Neighborhoods]:
    """Neighborhoods of a cloud, by what is special about them."""
    g = torch.Generator().manual_seed(seed)
    wide = tr.neighbors(cloud, 0.4, 40)
    shape, count = (len(wide), 150), len(wide)
    drawn = torch.randint(count, shape, generator=g) if count else torch.zeros(shape, dtype=torch.int64)
    square = torch.rand(shape, generator=g).to(wide.sq_distance) * (torch.rand(shape, generator=g) > 0.1)
    holes = tr.Neighborhoods(drawn, torch.rand(shape, generator=g) > 0.4, square)
    return {
        "wide": wide,
        "a view of fewer slots": wide.restrict(0.3, 17),
        "the point alone": wide.restrict(1e-6),
        "one slot": wide.restrict(max_neighbors=1),
        "holes": holes,
        "none valid": tr.Neighborhoods(drawn, torch.zeros(shape, dtype=torch.bool), square),
        "transposed": tr.Neighborhoods(*(part.t().contiguous().t() for part in (drawn, holes.valid, square))),
    }


KINDS = tuple(supports(cloud_of(8)))
COUNTS = (0, 1, 2, 63, 300)
