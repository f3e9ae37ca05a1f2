"""Which links to believe: groups of scans that grow together, the surest links first.

The start decides, not the optimizer: from a wrong tree no robust loss recovers. So links are looked at in the order of
their log-odds plus log(1 + the triangles that confirm them), as in Kruskal's maximum spanning tree; but where one would
join two groups, all links between these groups vote. Links that put the groups to each other alike are one ballot. It
must be more likely right than not, and clearly ahead of every other; else the groups wait for more evidence, and at
last stay apart.

Links that are wrong by accident hardly agree with each other, so a second and a third pair count much. Look-alike
places, such as floors of one plan, give many links that agree and are wrong, and more of them prove nothing. So the
number of pairs counts up to a few, sure links vote first and alone (``_ROUNDS``), and places of several scans are not
joined against links that are much likelier.

Scanners of known places are witnesses: where a vote would lay look-alike places onto each other, they saw through each
other's surfaces. So every ballot is weighed by what all of them would have seen. Where the links of a site contradict
each other, all of them are doubted; a scan or two that no link holds any more then join a place of several scans at
last, if its scanners speak for it.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torchreg.geometry.se3 import apply, compose, inverse
from torchreg.site.graph import SiteGraph, residuals
from torchreg.site.loops import Triangles, error_scale, support
from torchreg.site.optimize import settle_poses
from torchreg.site.site_sight import SiteSight
from torchreg.site.tolerance import Tolerance

_ROUNDS = ((4.0, True), (2.0, True), (0.0, True), (4.0, False), (2.0, False), (0.0, False), (-4.0, False))
"""Log-odds from which links vote, and whether only one that a triangle confirms may call for a vote."""

_CONFIRMING = 0.5  # triangles, each counted by the probability of its other two links

_AHEAD = math.log(3.0)  # of the next ballot
_CONFIRMED = math.log(30.0)  # bonus of a ballot for a second and for a third pair: by chance alone they hardly agree
_COUNTED = 5  # pairs of a ballot: more may be mistaken for one and the same reason
_OUTVOTED = 2.0  # log-odds by which links that lose a vote may be likelier than those that win it
_ROUGHLY = 1e-4  # radians and meters, to which poses are settled between the rounds
_PLACE = 6  # scans of a group that may be a place with a look-alike
_BALLOTS = 6  # at most, between two groups
_SPEAK, _LIKELY = 0.5, 1.0  # log-odds from which on scanners speak for a pose, and links that were doubted
_AGREEING = 2  # pairs whose doubted links agree
_SPOKEN = 3.0  # log-odds that scanners speak for a pose at most: those of a look-alike place all say the same
_ASKED = 16  # pairs of scanners of two groups, the nearest


class Start(NamedTuple):
    """Groups and rough poses."""

    group: list[int]  # of every node, the world included: a number of its own for each
    poses: Tensor  # (N + 1, 4, 4), of every node in the frame of its group
    believed: Tensor  # (K,) rows of the links that agree with them, at most one of a pair


class _Ballot(NamedTuple):
    row: int  # of its surest link
    agreeing: Tensor  # (R,) bool, of the links that were asked
    score: float  # log of the sum of their odds
    level: float  # mean log-odds of the likelier half of them
    pairs: int  # that say so, and one more where a triangle confirms a link of them
    seen: float = 0.0  # log-odds, from what the scanners of both groups saw if it is right
    against: float = 0.0  # the part of it that speaks against it


def choose(
    graph: SiteGraph, triangles: Triangles, tolerance: Tolerance, sight: SiteSight | None = None, doubt: float = 0.0
) -> Start:
    """Join scans by the links that are to be believed, as far as what scanners saw does not speak against it.

    ``doubt`` was taken from the log-odds of all links.
    """
    growth = _Growth(graph, triangles, tolerance, sight)
    growth.grow()
    if sight is not None and doubt > 0:
        growth.add_doubted(doubt)
    return growth.start()


def best_of_pairs(graph: SiteGraph, rows: Tensor, excess: Tensor) -> Tensor:
    """Of rows (R,) of links with an excess (R,), those of at most 1, one of a pair: the least, else the first."""
    best: dict[tuple[int, int], tuple[float, int]] = {}
    pairs = zip(graph.first[rows].tolist(), graph.second[rows].tolist(), strict=True)
    for pair, value, row in zip(pairs, excess.tolist(), rows.tolist(), strict=True):
        if value <= 1 and (value, row) < best.get(pair, (2.0, 0)):
            best[pair] = (value, row)
    return torch.tensor(sorted(row for _, row in best.values()), dtype=torch.int64)


class _Growth:
    def __init__(self, graph: SiteGraph, triangles: Triangles, tolerance: Tolerance, sight: SiteSight | None) -> None:
        self.graph, self.tolerance, self.sight = graph, tolerance, sight
        nodes = graph.count + 1
        self.ends: list[tuple[int, int]] = list(zip(graph.first.tolist(), graph.second.tolist(), strict=True))
        self.evidence = graph.evidence.tolist()
        confirming = support(triangles, graph.evidence.sigmoid())
        self.confirmed = (confirming >= _CONFIRMING).tolist()
        self.score = (graph.evidence + torch.log1p(confirming)).tolist()
        self.scale = error_scale(graph, triangles)
        self._expect_errors(self.scale)
        self.links: list[list[int]] = [[] for _ in range(nodes)]
        for row, (a, b) in enumerate(self.ends):
            self.links[a].append(row)
            self.links[b].append(row)
        self.tree: list[list[tuple[int, int]]] = [[] for _ in range(nodes)]  # neighbor, link
        self.group = list(range(nodes))
        self.members = {node: [node] for node in range(nodes)}
        self.poses = torch.eye(4, dtype=torch.float64).repeat(nodes, 1, 1)
        self.believed: list[Tensor] = []
        self.names = itertools.count(nodes)
        self.order = sorted(range(len(self.ends)), key=lambda row: (-self.score[row], row))

    def grow(self) -> None:
        """Join groups round by round."""
        for gate, confirmed in _ROUNDS:
            asked = [row for row in self.order if self.evidence[row] >= gate and (self.confirmed[row] or not confirmed)]
            self._round(asked, gate if confirmed else min(gate, 0.0))

    def add_doubted(self, doubt: float) -> None:
        """Join scans and small groups to larger ones by links that were doubted so much and that scanners speak for."""
        self._round([row for row in self.order if self.evidence[row] >= -doubt], -doubt, doubt)

    def start(self) -> Start:
        """What has grown."""
        return Start(self.group, self.poses, self._rows())

    def _round(self, asked: Sequence[int], gate: float, doubt: float = 0.0) -> None:
        refused: set[tuple[int, int]] = set()
        joined = len(self.believed)
        while sum(self._joined(row, gate, refused, doubt) for row in asked):
            pass
        if len(self.believed) > joined:
            self._relax()

    def _rows(self) -> Tensor:
        """The links that are believed, in order."""
        return torch.cat(self.believed).sort().values if self.believed else torch.zeros(0, dtype=torch.int64)

    def _relax(self) -> None:
        """Settle the poses of all groups, so that errors do not add up along chains, and learn how large they are."""
        fixed = torch.zeros(len(self.poses), dtype=torch.bool)
        for members in self.members.values():
            fixed[max(members) if self.graph.count in members else min(members)] = True
        settled = settle_poses(self.graph.take(self._rows()), self.poses, fixed, least_step=_ROUGHLY)
        self.poses = settled.poses
        self._expect_errors(max(self.scale, settled.scale))

    def _expect_errors(self, scale: float) -> None:
        """Let links err by as much as their covariances promise, squares times ``scale``."""
        self.turn_variance, self.shift_variance = self.tolerance.variances(self.graph, scale)
        self.variance = list(zip(self.turn_variance.tolist(), self.shift_variance.tolist(), strict=True))

    def _joined(self, row: int, gate: float, refused: set[tuple[int, int]], doubt: float) -> bool:
        """Whether the two groups of a link were joined."""
        one, other = sorted(self.group[node] for node in self.ends[row])
        if one == other or (one, other) in refused:
            return False
        few, many = sorted((one, other), key=lambda group: (len(self.members[group]), group))
        rows = self._between(few, many)
        ballots = self._ballots([k for k in rows if self.evidence[k] >= gate], few)
        if self.sight is not None:
            ballots = [self._witnessed(ballot, few, many) for ballot in ballots]
        ballots.sort(key=lambda ballot: (-_standing(ballot), ballot.row))
        first, rivals = ballots[0], ballots[1:]
        places = len(self.members[few]) >= _PLACE, len(self.members[many]) >= _PLACE
        outvoted = _OUTVOTED if places[0] else math.inf
        beaten = all(
            _standing(first) - _standing(rival) >= _AHEAD and rival.level - first.level <= outvoted for rival in rivals
        )
        if doubt > 0:  # what is known of a place by itself makes up for it
            likely = first.seen >= _SPEAK and first.score + doubt + first.against >= _LIKELY
            likely &= places == (False, True) and first.pairs >= _AGREEING
        else:  # what was seen makes nothing likely alone
            likely = first.score + min(first.seen, 0.0) >= 0
        if not likely or not beaten:
            refused.add((one, other))
            return False
        self._join(first.row, few, many, rows)
        return True

    def _witnessed(self, ballot: _Ballot, few: int, many: int) -> _Ballot:
        """A ballot with what scanners of both groups saw of each other's surfaces if it is right.

        The scanners that would stand nearest to each other are asked: look-alike places would lie on each other.
        """
        sight, zero = self.sight, self.graph.zero
        assert sight is not None  # the caller knows
        _, _, motion = self._motion(ballot.row, few)
        moved, others = (self._witnesses(group) for group in (few, many))
        if not moved or not others:
            return ballot
        poses = {scan: compose(motion, self.poses[scan]) for scan in moved} | {
            scan: self.poses[scan] for scan in others
        }
        stand = {scan: apply(pose, sight.scanner(scan)[None] - zero[scan])[0] for scan, pose in poses.items()}
        away = torch.stack([stand[scan] for scan in moved])[:, None] - torch.stack([stand[scan] for scan in others])
        apart = torch.linalg.vector_norm(away, dim=2).flatten()
        total = against = 0.0
        for place in apart.argsort(stable=True)[:_ASKED].tolist():
            k, m = divmod(place, len(others))
            source, target = moved[k], others[m]
            T = compose(inverse(poses[target]), poses[source])  # between frames about the zeros of the scans
            T[:3, 3] += zero[target] - T[:3, :3] @ zero[source]
            odds = sight.odds(source, target, T)
            total += odds
            against += min(odds, 0.0)
        return ballot._replace(seen=total, against=against)

    def _witnesses(self, group: int) -> list[int]:
        """The scans of a group whose scanners' places are known."""
        return [scan for scan in self.members[group] if self.sight is not None and self.sight.has(scan)]

    def _between(self, few: int, many: int) -> list[int]:
        """The links between two groups, in order."""
        return sorted(
            row for node in self.members[few] for row in self.links[node] if self.group[self._across(row, node)] == many
        )

    def _across(self, row: int, node: int) -> int:
        a, b = self.ends[row]
        return b if a == node else a

    def _ballots(self, rows: Sequence[int], few: int) -> list[_Ballot]:
        """What links say about how the group ``few`` lies to the other, those that say the same together."""
        index = torch.tensor(rows)
        evidence = self.graph.evidence[index]
        left = torch.ones(len(rows), dtype=torch.bool)
        ballots: list[_Ballot] = []
        for place in sorted(range(len(rows)), key=lambda k: (-self.score[rows[k]], rows[k])):
            if not left[place]:
                continue
            agreeing = (self._excess(rows[place], index, few)[0] <= 1) & left
            agreeing[place] = True
            left &= ~agreeing
            links = [rows[k] for k in agreeing.nonzero()[:, 0].tolist()]
            pairs = len({self.ends[row] for row in links}) + any(self.confirmed[row] for row in links)
            score = float(torch.logsumexp(evidence[agreeing], dim=0))
            likelier = evidence[agreeing].sort(descending=True).values
            level = float(likelier[: (len(likelier) + 1) // 2].mean())
            ballots.append(_Ballot(rows[place], agreeing, score, level, pairs))
            if len(ballots) == _BALLOTS:
                break
        return ballots

    def _excess(self, row: int, index: Tensor, few: int) -> tuple[Tensor, Tensor]:
        """How far links ``index`` disagree where link ``row`` is right, and the motion (4, 4) of the group ``few``."""
        graph = self.graph
        fixed, moving, motion = self._motion(row, few)
        poses = self.poses.clone()
        inside = self.members[few]
        poses[inside] = compose(motion, self.poses[inside])
        asked = graph.take(index)
        e = residuals(asked, poses)
        turn, shift = torch.linalg.vector_norm(e[:, :3], dim=1), torch.linalg.vector_norm(e[:, 3:], dim=1)
        turns, shifts = self.turn_variance[index].clone(), self.shift_variance[index].clone()
        others = index != row  # a link agrees with itself
        turns[others] += self.variance[row][0]
        shifts[others] += self.variance[row][1]
        for start in (fixed, moving):
            ends = [first if self.group[first] == self.group[start] else second for first, second in self._ends(index)]
            way = self._ways(start, set(ends))
            along = torch.tensor([way[node] for node in ends], dtype=torch.float64).view(-1, 2)
            arm = (poses[ends, :3, 3] - poses[fixed, :3, 3]).square().sum(dim=1)
            turns += along[:, 0]
            shifts += along[:, 1] + arm * (along[:, 0] + self.variance[row][0] / 2)
        return self.tolerance.excess(turn, shift, turns, shifts), motion

    def _motion(self, row: int, few: int) -> tuple[int, int, Tensor]:
        """The ends of link ``row`` outside and in the group ``few``, and the motion (4, 4) of that if it is right."""
        a, b = self.ends[row]
        T = self.graph.T[row] if self.group[a] != few else inverse(self.graph.T[row])
        fixed, moving = (a, b) if self.group[a] != few else (b, a)
        return fixed, moving, compose(compose(self.poses[fixed], T), inverse(self.poses[moving]))

    def _ends(self, index: Tensor) -> list[tuple[int, int]]:
        return [self.ends[row] for row in index.tolist()]

    def _ways(self, start: int, ends: set[int]) -> dict[int, tuple[float, float]]:
        """The sums of the variances of turns and shifts along the tree from a node to each of ``ends``."""
        way = {start: (0.0, 0.0)}
        waiting, missing = deque([start]), len(ends - {start})
        while missing:
            node = waiting.popleft()
            turn, shift = way[node]
            for other, row in self.tree[node]:
                if other not in way:
                    way[other] = (turn + self.variance[row][0], shift + self.variance[row][1])
                    waiting.append(other)
                    missing -= other in ends
        return way

    def _join(self, row: int, few: int, many: int, rows: Sequence[int]) -> None:
        index = torch.tensor(rows)
        excess, motion = self._excess(row, index, few)
        excess[index == row] = 0.0
        self.believed.append(best_of_pairs(self.graph, index, excess))
        inside = self.members.pop(few)
        self.poses[inside] = compose(motion, self.poses[inside])
        a, b = self.ends[row]
        self.tree[a].append((b, row))
        self.tree[b].append((a, row))
        both = self.members.pop(many) + inside
        name = next(self.names)
        self.members[name] = both
        for node in both:
            self.group[node] = name


def _standing(ballot: _Ballot) -> float:
    return (
        ballot.level
        + math.log(min(ballot.pairs, _COUNTED))
        + _CONFIRMED * (min(ballot.pairs, 3) - 1)
        + min(ballot.seen, _SPOKEN)
    )
