"""The two sides of all pairs of a call, every distinct cloud looked at, thinned and described once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from torchreg.registration.describe import downsample
from torchreg.registration.described import DescribedClouds
from torchreg.registration.describing import describe_thin, description_options
from torchreg.registration.inspect import facts_of, refusal, set_aside
from torchreg.registration.recipes import blocks_of, recipes_of
from torchreg.registration.same_clouds import same_clouds
from torchreg.registration.stopwatch import Stopwatch
from torchreg.types import Clouds, Failure, RegistrationOptions

_NOTHING = -1


class _Entry(NamedTuple):
    """A cloud to be described: its number (-1 is one without points), with what, and for whom.

    ``owner`` tells the sides of pairs apart where a description depends on the pair, else it is 0.
    """

    cloud: int
    options: RegistrationOptions
    owner: int


class Sides:
    """Source and target of B pairs: ``usable``, then ``thin``, then ``described`` for every slice in order."""

    def __init__(self, source: Clouds, target: Clouds) -> None:
        self._given = (source, target)
        self._numbers = same_clouds(self._given)
        self._colored = source.colors is not None and target.colors is not None
        single = [*source.unpack(), *target.unpack()]
        distinct = {number: single[number] for side in self._numbers for number in side}
        self._facts = {number: facts_of(cloud)[0] for number, cloud in distinct.items()}
        # normals are estimated anew, and colors of one side alone tell nothing: so all clouds can be packed
        self._clouds = {
            number: replace(cloud, normals=None, colors=cloud.colors if self._colored else None)
            for number, cloud in distinct.items()
        }
        self._clouds[_NOTHING] = set_aside(self._clouds[self._numbers[0][0]], [True])

    @property
    def numbers(self) -> list[list[int]]:
        """Of the clouds that ``usable`` gives, both sides; equal clouds have equal ones."""
        refused = self._refused([None] * len(self._given[0]))
        return [
            [_NOTHING if reason else number for number, reason in zip(side, refused, strict=True)]
            for side in self._numbers
        ]

    def usable(self) -> tuple[Clouds, Clouds]:
        """Both sides, those of pairs that cannot be registered without points."""
        refused = self._refused([None] * len(self._given[0]))
        return set_aside(self._given[0], refused), set_aside(self._given[1], refused)

    def thin(self, options: Sequence[RegistrationOptions], watch: Stopwatch) -> None:
        """Downsample every cloud that is to be described, by the options of its pair."""
        first = options[0]
        self._blocks = blocks_of(recipes_of(first, self._colored))
        self._joint = first.equalization == "joint" and "pcfh" in self._blocks
        refused = self._refused(options)

        def entry(b: int, side: int) -> _Entry:
            number = _NOTHING if refused[b] else self._numbers[side][b]
            owner = 2 * b + side if self._joint else 0
            return _Entry(number, description_options(options[b], self._blocks), owner)

        self._pairs = [(entry(b, 0), entry(b, 1)) for b in range(len(options))]
        distinct = dict.fromkeys(entry for pair in self._pairs for entry in pair)
        self._thin = {entry: downsample(self._clouds[entry.cloud], [entry.options]) for entry in distinct}
        self._last = {entry: b for b, pair in enumerate(self._pairs) for entry in pair}
        self._described: dict[_Entry, DescribedClouds] = {}
        watch.lap("downsample")

    def sizes(self) -> list[int]:
        """Points of every pair after thinning, both clouds together."""
        return [len(self._thin[one].points) + len(self._thin[other].points) for one, other in self._pairs]

    def described(self, rows: slice, watch: Stopwatch, max_bytes: int) -> tuple[DescribedClouds, DescribedClouds]:
        """Both sides of these pairs; what no later pair needs is let go."""
        pairs = self._pairs[rows]
        new = list(dict.fromkeys(entry for pair in pairs for entry in pair if entry not in self._described))
        if new:
            found = describe_thin(
                Clouds.pack([self._thin[entry] for entry in new]),
                [entry.options for entry in new],
                self._blocks,
                watch,
                max_bytes=max_bytes,
                joint=self._joint,
            )
            self._described.update(zip(new, found.unpack(), strict=True))
        sides = [
            replace(
                DescribedClouds.pack([self._described[pair[side]] for pair in pairs]),
                facts=tuple(self._facts[number] for number in self._numbers[side][rows]),
            )
            for side in range(2)
        ]
        # what stays is copied out of its batch, whose memory it would hold otherwise
        later = {entry: item for entry, item in self._described.items() if self._last[entry] >= rows.stop}
        self._described = {entry: item.clone() if entry in new else item for entry, item in later.items()}
        return sides[0], sides[1]

    def _refused(self, options: Sequence[RegistrationOptions | None]) -> list[Failure | None]:
        return [
            refusal(self._facts[one], self._facts[other], option)
            for one, other, option in zip(*self._numbers, options, strict=True)
        ]
