"""A first look at every cloud of a batch, and the lengths of every pair that follow."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import NamedTuple

from torchreg.batch.clouds import CloudSource, Look, sources_of
from torchreg.batch.engines import Engine
from torchreg.batch.jobs import DERIVE, LOOK, DeriveItem, LookItem
from torchreg.batch.outcome import Outcome, stop_without_room
from torchreg.batch.pairs import Pair
from torchreg.batch.progress import Progress, Report
from torchreg.batch.scales import Scale, shared_scales
from torchreg.batch.store import Store
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.pair_options import changed
from torchreg.registration.presets import PAPER
from torchreg.registration.spacing import MAX_POINTS, options_of_spacings

CloudKey = tuple[CloudSource, float | None]
"""A cloud, and the voxel edge that was given for it."""


class Survey(NamedTuple):
    """What is known of the clouds.

    Attributes:
        looks: of all that could be read.
        unreadable: why the others could not.
        scales: that are shared, of the clouds that share one.
    """

    looks: dict[CloudKey, Look]
    unreadable: dict[CloudKey, Outcome]
    scales: dict[CloudKey, Scale]

    def trouble(self, pair: Pair) -> Outcome | None:
        """What came of a cloud of the pair that cannot be read; ``None`` where both can."""
        return next((self.unreadable[cloud] for cloud in clouds_of(pair) if cloud in self.unreadable), None)

    def looks_of(self, pair: Pair) -> tuple[Look, Look]:
        """Of source and target."""
        one, other = clouds_of(pair)
        return self.looks[one], self.looks[other]


def clouds_of(pair: Pair) -> tuple[CloudKey, CloudKey]:
    """The clouds of a pair, with the voxel edge that their scale is measured after."""
    given = pair.settings.overrides.voxel if _needs_scale(pair) else None
    one, other = sources_of(pair)
    return (one, given), (other, given)


def survey(pairs: Sequence[Pair], store: Store, engine: Engine, report: Report) -> Survey:
    """Look at every cloud; one whose file did not change since it was looked at is not read again."""
    scaled: dict[CloudKey, bool] = {}
    for pair in pairs:
        for cloud in clouds_of(pair):
            scaled[cloud] = scaled.get(cloud, False) or _needs_scale(pair)
    known = store.looks()
    found = Survey({}, {}, {})
    new: list[tuple[CloudKey, str]] = []
    for cloud, wanted in scaled.items():
        stamp = f"{_stamp(cloud[0].path)} {wanted}"
        if cloud in known and known[cloud][0] == stamp:
            found.looks[cloud] = known[cloud][1]
        else:
            new.append((cloud, stamp))
    items = [LookItem(source, asked, scaled[source, asked]) for (source, asked), _ in new]
    before = len(found.looks)
    report(Progress("look", before, len(scaled)))
    for count, (place, outcome) in enumerate(engine.run(LOOK, items), start=1):
        stop_without_room(outcome)
        cloud, stamp = new[place]
        store.add_work("looking at clouds", outcome.seconds)
        if outcome.reason:
            found.unreadable[cloud] = outcome
        else:
            found.looks[cloud] = outcome.value
            store.keep_look(*cloud, stamp, outcome.value)
        report(Progress("look", before + count, len(scaled)))
    own = {cloud: Scale(look.voxel, look.spacing) for cloud, look in found.looks.items()}
    links = [clouds_of(pair) for pair in pairs if _shares_scale(pair) and not found.trouble(pair)]
    found.scales.update(shared_scales({cloud: own[cloud] for link in links for cloud in link}, links))
    return found


def options_of_pairs(
    pairs: Sequence[Pair], found: Survey, store: Store, engine: Engine
) -> tuple[dict[str, RegistrationOptions], dict[str, Outcome]]:
    """The complete options of readable pairs by name, and what came of those for which they could not be found."""
    options: dict[str, RegistrationOptions] = {}
    lost: dict[str, Outcome] = {}
    alone = []
    for pair in pairs:
        if not _needs_scale(pair):
            options[pair.name] = PAPER
        elif _is_thinned_alone(pair, found):
            alone.append(pair)
        else:
            options[pair.name] = _default_options(pair, found)
    items = [DeriveItem(*sources_of(pair)) for pair in alone]
    for place, outcome in engine.run(DERIVE, items):
        stop_without_room(outcome)
        store.add_work("looking at clouds", outcome.seconds)
        if outcome.reason:
            lost[alone[place].name] = outcome
        else:
            options[alone[place].name] = outcome.value
    return {pair.name: _told(pair, options[pair.name]) for pair in pairs if pair.name in options}, lost


def own_lengths(pair: Pair, found: Survey) -> bool:
    """Whether the lengths of a pair follow from its own clouds alone, or from nothing."""
    return not (_shares_scale(pair) and all(cloud in found.scales for cloud in clouds_of(pair)))


def _default_options(pair: Pair, found: Survey) -> RegistrationOptions:
    looks, clouds = found.looks_of(pair), clouds_of(pair)
    colored = all(look.colored for look in looks)
    own = [Scale(look.voxel, look.spacing) for look in looks]
    used = own if own_lengths(pair, found) else [found.scales[cloud] for cloud in clouds]
    voxel, scale = max(one.voxel for one in used), max(one.spacing for one in used)
    apart = (own[0].spacing, own[1].spacing)
    return options_of_spacings(apart, voxel if voxel > 0 else None, scale=scale, colored=colored)


def _is_thinned_alone(pair: Pair, found: Survey) -> bool:
    """Whether voxels are to be found for this very pair: then its spacings are measured after these."""
    large = max(look.points for look in found.looks_of(pair)) > MAX_POINTS
    return large and pair.settings.overrides.voxel is None and own_lengths(pair, found)


def _told(pair: Pair, options: RegistrationOptions) -> RegistrationOptions:
    """The options with what was said over them."""
    return changed(pair.settings.overrides.over(options), pair.settings.effort, pair.settings.solver)


def _needs_scale(pair: Pair) -> bool:
    return pair.settings.preset == "default"


def _shares_scale(pair: Pair) -> bool:
    return _needs_scale(pair) and pair.settings.scale == "shared"


def _stamp(path: str) -> str:
    """What tells that a file was changed."""
    try:
        found = os.stat(path)
    except OSError:
        return "missing"
    return f"{found.st_size} {found.st_mtime_ns}"
