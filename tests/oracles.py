"""What the clever functions must equal, written as plainly as the papers state it: loops over Python numbers."""

from __future__ import annotations

import math
from collections import defaultdict

import numpy as np
import torch
from torch import Tensor

import torchreg as tr
from torchreg.types.packing import spans


def pair_angles(p1: list[float], n1: list[float], p2: list[float], n2: list[float]) -> tuple[float, float, float]:
    """(f1, f2, f3) of Rusu et al. 2009 by arc cosine and arc tangent, roles exchanged as in PCL and Open3D."""
    line = np.subtract(p2, p1)
    length = math.sqrt(float(line @ line))
    if length == 0:
        return 0.0, 0.0, 0.0
    first, second = np.asarray(n1), np.asarray(n2)
    cosine1, cosine2 = float(first @ line) / length, float(second @ line) / length
    if math.acos(min(1.0, abs(cosine1))) > math.acos(min(1.0, abs(cosine2))):
        first, second, line, cosine1 = second, first, -line, -cosine2
    v = np.cross(line, first)
    across = math.sqrt(float(v @ v))
    if across == 0:
        return 0.0, 0.0, 0.0
    v = v / across
    w = np.cross(first, v)
    return math.atan2(float(w @ second), float(first @ second)), float(v @ second), cosine1


def angle_positions(angles: tuple[float, float, float]) -> tuple[float, float, float]:
    """Where the three angles lie on the axis of their 11 bins, [0, 11] each."""
    f1, f2, f3 = angles
    return 11 * (f1 + math.pi) / (2 * math.pi), 11 * (f2 + 1) / 2, 11 * (f3 + 1) / 2


def spfh(points: Tensor, normals: Tensor, near: tr.Neighborhoods) -> Tensor:
    """(P, 33) float64: percent of the neighbors besides the point itself per bin."""
    out = torch.zeros(len(points), 33, dtype=torch.float64)
    p, n = points.tolist(), normals.tolist()
    for i, others in enumerate(neighbor_lists(near)):
        for j, _ in others:
            for block, position in enumerate(angle_positions(pair_angles(p[i], n[i], p[j], n[j]))):
                out[i, 11 * block + min(10, max(0, math.floor(position)))] += 100 / len(others)
    return out


def fpfh(points: Tensor, normals: Tensor, near: tr.Neighborhoods, *, own: bool = True) -> Tensor:
    """(P, 33) float64 by the paper's Eq. (2)."""
    return weighted_histograms(spfh(points, normals, near), near, block=11, own=own)


def hhd(
    values: Tensor, near: tr.Neighborhoods, bins: int, channels: tuple[str, ...] = ("hue",), *, weighted: bool = False
) -> Tensor:
    """(P, bins x channels) float64, the paper's Eq. (3), in percent; zero rows for fewer than 3 neighbors."""
    out = torch.zeros(len(values), bins * len(channels), dtype=torch.float64)
    rows = values.tolist()
    for i, others in enumerate(neighbor_lists(near)):
        if len(others) < 3:
            continue
        for place, channel in enumerate(channels):
            votes = [0.0] * bins
            for j, _ in others:
                column = ("hue", "saturation", "value").index(channel)
                difference = abs(rows[i][column] - rows[j][column])
                if channel == "hue":
                    difference = 2 * min(difference, 1 - difference)
                vote = rows[i][1] * rows[j][1] if weighted and channel == "hue" else 1.0
                votes[min(bins - 1, math.floor(difference * bins))] += vote
            total = sum(votes)
            if total > 0:
                histogram = torch.tensor([100 * vote / total for vote in votes], dtype=torch.float64)
                out[i, place * bins : (place + 1) * bins] = histogram
    return out


def pcfh(
    values: Tensor, near: tr.Neighborhoods, bins: int, channels: tuple[str, ...] = ("hue",), *, weighted: bool = False
) -> Tensor:
    """(P, bins x channels) float64, the paper's Eq. (4) on top of Eq. (3)."""
    own = hhd(values, near, bins, channels, weighted=weighted)
    out = weighted_histograms(own, near, block=bins, own=True)
    few = torch.tensor([len(others) < 3 for others in neighbor_lists(near)], dtype=torch.bool)
    return out.masked_fill(few[:, None], 0)


def weighted_histograms(table: Tensor, near: tr.Neighborhoods, *, block: int, own: bool) -> Tensor:
    """The neighbors' histograms by 1/d^2, every block scaled to 100, plus the own one."""
    out = torch.zeros_like(table)
    for i, others in enumerate(neighbor_lists(near)):
        for j, square in others:
            if square > 0:
                out[i] += table[j] / square
        for begin in range(0, table.shape[1], block):
            total = float(out[i, begin : begin + block].sum())
            if total > 0:
                out[i, begin : begin + block] *= 100 / total
    return out + table if own else out


def neighbor_lists(near: tr.Neighborhoods) -> list[list[tuple[int, float]]]:
    """(row, squared distance) of the valid neighbors of every point, without the point itself."""
    rows = zip(near.index.tolist(), near.valid.tolist(), near.sq_distance.double().tolist(), strict=True)
    return [
        [(j, square) for j, counts, square in zip(*row, strict=True) if counts and j != i] for i, row in enumerate(rows)
    ]


def mutual_matches(source: tr.Features, target: tr.Features, ratio: float | None = None) -> list[tuple[int, int]]:
    """(source row, target row) of all pairs that are each other's nearest in float64, ties to the lower row."""
    found = []
    for (begin, end), (first, last) in zip(spans(source.offsets), spans(target.offsets), strict=True):
        left = [i for i in range(begin, end) if bool(source.valid[i])]
        right = [k for k in range(first, last) if bool(target.valid[k])]
        if not left or not right:
            continue
        difference = source.values[left].double()[:, None] - target.values[right].double()[None]
        distance = (difference * difference).sum(dim=2).sqrt().numpy()  # (N, M)
        forth, back = distance.argmin(axis=1), distance.argmin(axis=0)  # numpy: the first of equals
        for i, k in enumerate(forth):
            others = np.delete(distance[i], k)
            clear = ratio is None or len(others) == 0 or distance[i, k] < ratio * others.min()
            if back[k] == i and clear:
                found.append((left[i], right[k]))
    return found


def voxel_means(points: Tensor, size: float, *more: Tensor) -> dict[tuple[int, ...], list[Tensor]]:
    """Mean point, and mean of every tensor in ``more``, of the points in each voxel, by voxel."""
    members = defaultdict(list)
    wide = points.double()
    low = wide.min(dim=0).values - size / 2
    for row, point in enumerate(wide):
        members[tuple(math.floor(float(c)) for c in (point - low) / size)].append(row)
    return {voxel: [values[rows].double().mean(dim=0) for values in (points, *more)] for voxel, rows in members.items()}


def kabsch(source: Tensor, target: Tensor, weights: Tensor | None = None) -> Tensor:
    """(4, 4) float64 by numpy's singular values (Umeyama 1991)."""
    p, q = source.double().numpy(), target.double().numpy()
    w = np.ones(len(p)) if weights is None else weights.double().numpy()
    p_mean, q_mean = np.average(p, axis=0, weights=w), np.average(q, axis=0, weights=w)
    u, _, vt = np.linalg.svd((q - q_mean).T @ np.diag(w) @ (p - p_mean))
    d = np.diag([1, 1, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    T = np.eye(4)
    T[:3, :3] = u @ d @ vt
    T[:3, 3] = q_mean - T[:3, :3] @ p_mean
    return torch.from_numpy(T)


def rre(T_true: Tensor, T_estimated: Tensor) -> float:
    """Degrees, the paper's Eq. (5)."""
    cosine = (float(torch.trace(T_true[:3, :3].t() @ T_estimated[:3, :3])) - 1) / 2
    return math.degrees(math.acos(max(-1.0, min(1.0, cosine))))


def farthest_points(points: Tensor, count: int) -> list[int]:
    """Rows, ascending: the one farthest from the mean, then always the farthest from those chosen."""
    rows = points.double().tolist()
    mean = [math.fsum(row[axis] for row in rows) / len(rows) for axis in range(3)]
    chosen = [max(range(len(rows)), key=lambda i: (math.dist(rows[i], mean), -i))]
    while len(chosen) < count:
        apart = [min(math.dist(row, rows[i]) for i in chosen) for row in rows]
        chosen.append(max(range(len(rows)), key=lambda i: (apart[i], -i)))
    return sorted(chosen)


def contrast(colors: Tensor, near: tr.Neighborhoods, radius: float) -> Tensor:
    """(P, 10) float64: spread near, spread far and shift per channel over the local mean, and a constant."""
    out = torch.zeros(len(colors), 10, dtype=torch.float64)
    values = colors.double().numpy()
    rows = zip(near.index.tolist(), near.valid.tolist(), near.sq_distance.double().tolist(), strict=True)
    for i, row in enumerate(rows):
        whole = [j for j, counts, _ in zip(*row, strict=True) if counts]
        core = [j for j, counts, square in zip(*row, strict=True) if counts and square < (0.4 * radius) ** 2]
        if len(whole) < 2:
            continue
        numbers = []
        for channel in range(3):
            near_by, far = values[core, channel], values[whole, channel]
            far_level = far.mean() + 0.05
            numbers += [near_by.std() / (near_by.mean() + 0.05), far.std() / far_level]
            numbers.append((near_by.mean() - far.mean()) / far_level)
        out[i] = torch.tensor([*numbers, 0.3], dtype=torch.float64)
    return out
