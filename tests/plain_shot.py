"""SHOT by plain loops over neighbors, angles by acos and atan2: what the vector code is compared with."""

import math

import torch


def shot(points, values, bins, frames, radius):
    """Rows (P, 32 x (bins + 1)), not divided by their length; values[p](k) in [0, bins] is what is counted."""
    rows = torch.zeros(len(points), 32 * (bins + 1), dtype=torch.float64)
    for p in range(len(points)):
        if bool((frames[p] == 0).all()):
            continue
        for k in range(len(points)):
            offset = points[k] - points[p]
            distance = float(offset.norm())
            if 0 < distance < radius:
                _vote(rows[p], (frames[p] @ offset).tolist(), distance / radius, values(p, k), bins)
    return rows


def _vote(row, position, relative, value, bins):
    x, y, z = position
    azimuth, elevation = math.atan2(y, x), math.acos(z / math.hypot(x, y, z))
    sector = min(7, math.floor((azimuth + math.pi) / (math.pi / 4)))
    shell, half, bin_ = relative > 0.5, elevation < math.pi / 2, math.floor(value + 0.5)
    turn = (azimuth + math.pi) / (math.pi / 4) - sector - 0.5
    out = 2 * relative - 0.5 - shell  # from the middle of the shell
    down = elevation / (math.pi / 2) - 1.5 + half
    beside = value - bin_
    volume = 4 * sector + 2 * shell + half

    def add(volume, bin_, share):
        row[volume * (bins + 1) + bin_] += share

    add(volume, bin_, 4 - abs(turn) - abs(out) - abs(down) - abs(beside))
    add(4 * ((sector + (1 if turn > 0 else 7)) % 8) + 2 * shell + half, bin_, abs(turn))
    if (out < 0) == shell:
        add(volume + (-2 if shell else 2), bin_, abs(out))
    if (down > 0) == half:
        add(volume + (-1 if half else 1), bin_, abs(down))
    add(volume, (bin_ + (1 if beside > 0 else bins - 1)) % bins, abs(beside))
