"""Judges a transform that another program found: how probable is it that it is right, and what speaks against it?"""

import math

import torch

import torchreg as tr

hall = tr.datasets.mall(seed=1, angular_step=1.2)
source, target = hall.source, hall.target

found_elsewhere = hall.T_target_source  # 4x4, x_target = R x_source + t, in meters
half_turn = torch.eye(4, dtype=torch.float64)
half_turn[:2, :2] = torch.tensor([[math.cos(math.pi), -math.sin(math.pi)], [math.sin(math.pi), math.cos(math.pi)]])
for name, T in (("the truth", found_elsewhere), ("turned by half a turn", half_turn @ found_elsewhere)):
    verdict = tr.verify(source, target, T[None])
    print(f"{name}: probability {float(verdict.probability[0]):.3f}, {verdict.reason[0] or 'nothing against it'}")
print(verdict.explain())  # with the better pose that was found, where there is one
