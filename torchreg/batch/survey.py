"""The measures of every cloud of a batch, and the options of every pair that follow from them."""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Sequence
from typing import NamedTuple

from torchreg.batch.clouds import CloudMeasures, CloudSource, sources_of
from torchreg.batch.engine import BatchProgress, Engine, Outcome, Report, stop_without_room
from torchreg.batch.jobs import DERIVE, MEASURE, DeriveItem, MeasureItem
from torchreg.batch.pairs import Pair
from torchreg.batch.store import Store
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.scales import Scale, shared_scales
from torchreg.registration.spacing import MAX_POINTS, options_of_spacings
from torchreg.settings import PRESETS

_BLOCK = 1 << 16  # bytes that are read at a place of a file
_PLACES = 16  # where a large file is read, from its first block to its last

CloudKey = tuple[CloudSource, float | None]
"""A cloud, and the voxel edge that was given for it."""


class Survey(NamedTuple):
    """What is known of the clouds."""

    measures: dict[CloudKey, CloudMeasures]  # of all that could be read
    unreadable: dict[CloudKey, Outcome]  # why the others could not
    scales: dict[CloudKey, Scale]  # of the clouds that share one

    def trouble(self, pair: Pair) -> Outcome | None:
        """The outcome of a cloud of the pair that cannot be read; ``None`` where both can."""
        return next((self.unreadable[cloud] for cloud in clouds_of(pair) if cloud in self.unreadable), None)

    def measures_of(self, pair: Pair) -> tuple[CloudMeasures, CloudMeasures]:
        """Of source and target."""
        source, target = clouds_of(pair)
        return self.measures[source], self.measures[target]

    def digests_of(self, pair: Pair) -> tuple[str, str]:
        """Of source and target."""
        source, target = self.measures_of(pair)
        return source.digest, target.digest


def clouds_of(pair: Pair) -> tuple[CloudKey, CloudKey]:
    """The clouds of a pair, with the voxel edge that their scale is measured after."""
    voxel = pair.settings.voxel if _needs_scale(pair) else None
    source, target = sources_of(pair)
    return (source, voxel), (target, voxel)


def survey_clouds(pairs: Sequence[Pair], store: Store, engine: Engine, report: Report) -> Survey:
    """Measure every cloud; one whose file did not change since it was measured is not read again."""
    scaled: dict[CloudKey, bool] = {}
    for pair in pairs:
        for cloud in clouds_of(pair):
            scaled[cloud] = scaled.get(cloud, False) or _needs_scale(pair)
    known = store.measures()
    survey = Survey({}, {}, {})
    new: list[tuple[CloudKey, str]] = []
    for cloud, is_scaled in scaled.items():
        stamp = f"{stamp_of(cloud[0].path)} {is_scaled}"
        if cloud in known and known[cloud][0] == stamp:
            survey.measures[cloud] = known[cloud][1]
        else:
            new.append((cloud, stamp))
    items = [MeasureItem(source, voxel, scaled[source, voxel]) for (source, voxel), _ in new]
    before = len(survey.measures)
    report(BatchProgress("measure", before, len(scaled)))
    for count, (place, outcome) in enumerate(engine.run(MEASURE, items), start=1):
        stop_without_room(outcome)
        cloud, stamp = new[place]
        store.add_work("measuring clouds", outcome.seconds)
        if outcome.reason:
            survey.unreadable[cloud] = outcome
        else:
            survey.measures[cloud] = outcome.value
            store.keep_measures(*cloud, stamp, outcome.value)
        report(BatchProgress("measure", before + count, len(scaled)))
    alone = {cloud: Scale(one.voxel, one.spacing) for cloud, one in survey.measures.items()}
    links = [clouds_of(pair) for pair in pairs if _shares_scale(pair) and not survey.trouble(pair)]
    survey.scales.update(shared_scales({cloud: alone[cloud] for link in links for cloud in link}, links))
    return survey


def options_of_pairs(
    pairs: Sequence[Pair], survey: Survey, store: Store, engine: Engine
) -> tuple[dict[str, RegistrationOptions], dict[str, Outcome]]:
    """The options of readable pairs by name, and the outcome of those for which they could not be derived."""
    options: dict[str, RegistrationOptions] = {}
    lost: dict[str, Outcome] = {}
    alone = []
    for pair in pairs:
        preset = PRESETS[pair.settings.preset]
        if preset is not None:
            options[pair.name] = preset
        elif _is_thinned_alone(pair, survey):
            alone.append(pair)
        else:
            options[pair.name] = _default_options(pair, survey)
    items = [DeriveItem(*sources_of(pair), _effort(pair)) for pair in alone]
    for place, outcome in engine.run(DERIVE, items):
        stop_without_room(outcome)
        store.add_work("measuring clouds", outcome.seconds)
        if outcome.reason:
            lost[alone[place].name] = outcome
        else:
            options[alone[place].name] = outcome.value
    return {pair.name: pair.settings.over(options[pair.name]) for pair in pairs if pair.name in options}, lost


def lengths_stand_alone(pair: Pair, survey: Survey) -> bool:
    """Whether the lengths of a pair follow from its two clouds alone, or from no cloud."""
    return not (_shares_scale(pair) and all(cloud in survey.scales for cloud in clouds_of(pair)))


def _default_options(pair: Pair, survey: Survey) -> RegistrationOptions:
    measures, clouds = survey.measures_of(pair), clouds_of(pair)
    colored = all(one.colored for one in measures)
    alone = [Scale(one.voxel, one.spacing) for one in measures]
    scales = alone if lengths_stand_alone(pair, survey) else [survey.scales[cloud] for cloud in clouds]
    voxel, scale = max(one.voxel for one in scales), max(one.spacing for one in scales)
    apart = (alone[0].spacing, alone[1].spacing)
    return options_of_spacings(apart, voxel if voxel > 0 else None, scale=scale, colored=colored, effort=_effort(pair))


def _is_thinned_alone(pair: Pair, survey: Survey) -> bool:
    """Whether the voxels depend on both clouds of this pair alone; its spacings are measured after them then."""
    large = max(one.points for one in survey.measures_of(pair)) > MAX_POINTS
    return large and pair.settings.voxel is None and lengths_stand_alone(pair, survey)


def _effort(pair: Pair) -> str:
    return pair.settings.effort or "balanced"


def _needs_scale(pair: Pair) -> bool:
    return PRESETS[pair.settings.preset] is None


def _shares_scale(pair: Pair) -> bool:
    return _needs_scale(pair) and pair.settings.scale == "shared"


def stamp_of(path: str) -> str:
    """A text that changes with the file: its size, its times, its number on the disk, and a digest of its content.

    The digest is of the whole file up to a megabyte, beyond that of sixteen blocks spread over it. A write sets the
    time of change, which no program can set back as it can the time of modification. So what stays unseen is a large
    file that was written between these blocks, at the same size, while the clock stood where it stood before, under a
    file system that keeps no such time, or beneath the file system.
    """
    try:
        status = os.stat(path)
        if not stat.S_ISREG(status.st_mode):  # a pipe would wait for a writer
            return "no file"
        content = _content_digest(path, status.st_size)
    except OSError:
        return "missing"
    return f"{status.st_size} {status.st_mtime_ns} {status.st_ctime_ns} {status.st_ino} {content}"


def _content_digest(path: str, size: int) -> str:
    """Of all bytes of a small file, of blocks at places spread evenly over a large one."""
    digest = hashlib.blake2b(digest_size=16)
    with open(path, "rb", buffering=0) as file:
        last = max(0, size - _BLOCK)
        whole = size <= _PLACES * _BLOCK
        for begin in range(0, size, _BLOCK) if whole else [last * k // (_PLACES - 1) for k in range(_PLACES)]:
            file.seek(begin)
            digest.update(file.read(_BLOCK))
    return digest.hexdigest()
