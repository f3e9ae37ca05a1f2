"""Settings that are most likely to help, each chosen by a figure of the run.

A rule reads one figure and returns what it would change, naming the figure, or an empty text. The kind of the failure
decides which rules come first.
"""

from __future__ import annotations

from collections.abc import Callable

from torchreg.registration.options import RegistrationOptions
from torchreg.report.explain.facts import FIRM_STRENGTH, Facts
from torchreg.report.text import chance, counted, decimal, meters, odds, percent, share
from torchreg.solvers import RansacOptions

_MOST = 2
_LIKELY = 0.9
_FEW_POINTS, _FEW_MATCHES = 500, 200
_HARDLY_ANY = 100  # points
_FEW_FEATURES = 0.8  # of the points
_FEW_INLIERS = 0.05  # of the matches
_FINE = 0.75  # voxels: a threshold below that is finer than the points
_LITTLE_OVERLAP = 0.2
_CLOSE_MARGIN = 3.0  # 20 to 1
_MUCH_CONFLICT, _POOR_NORMALS, _POOR_COLORS = 0.1, 0.6, 0.2


def advice(facts: Facts) -> list[str]:
    """At most two pieces of advice, the likeliest to help first; where there is none, one sentence on why."""
    if facts.success and (facts.probability is None or facts.probability >= _LIKELY):
        if facts.probability is None:
            return ['nothing in the matches; an effort other than "plain" weighs the pose against the clouds as well']
        return [f"nothing needs to change (probability {chance(facts.probability)})"]
    kind = "" if facts.failure is None else facts.failure.kind
    only = {**CLOUD_RULES, **IMPOSTOR_RULES}.get(kind)
    first = (_hardly_any, *FIRST_RULES.get(kind, ()))
    rules = dict.fromkeys((*first, *_GENERAL_RULES)) if only is None else only
    texts = list(dict.fromkeys(text for rule in rules if (text := rule(facts))))[:_MOST]
    nothing = "no figure above points to one setting" if only is None else "other clouds: the reason says why"
    return texts or [nothing]


def _points(facts: Facts) -> str:
    if facts.stages is None:
        return ""
    sides = zip(("source", "target"), facts.stages.given, facts.stages.points, strict=True)
    # a pair refused for its clouds was not downsampled, and has none left
    left, given, name = min((points or count, count, name) for name, count, points in sides)
    if left >= _FEW_POINTS:
        return ""
    if facts.options is not None and facts.options.voxel_size is not None and given > 2 * left:
        smaller = f"a smaller voxel_size (now {meters(facts.options.voxel_size)})"
        return f"{smaller}: it leaves only {left:,} of the {given:,} points of the {name}"
    return f"denser clouds: one has only {counted(left, 'point')}"


def _hardly_any(facts: Facts) -> str:
    """As ``_points`` where so few are left that nothing else is to blame."""
    return _points(facts) if facts.stages is not None and min(facts.stages.points) < _HARDLY_ANY else ""


def _units(facts: Facts) -> str:
    factor = 0.0 if facts.failure is None else facts.failure.figures.get("factor", 0.0)
    return f"both clouds in one unit: divide the coordinates of the larger one by {factor:g}" if factor else ""


def _handedness(facts: Facts) -> str:
    return "clouds of one handedness: check both exports, or change the sign of one axis of one cloud"


def _scale(facts: Facts) -> str:
    factor = 0.0 if facts.failure is None else facts.failure.figures.get("factor", 0.0)
    return (
        f"clouds of one scale: multiply the source's coordinates by {factor:.5g}, or check the units" if factor else ""
    )


def _voxels(facts: Facts) -> str:
    voxel = None if facts.failure is None else facts.failure.figures.get("voxel_size")
    return "" if voxel is None else f"a larger voxel_size (now {meters(voxel)})"


def _threshold(facts: Facts) -> str:
    if facts.options is None or facts.options.voxel_size is None or facts.threshold is None:
        return ""
    voxel = facts.options.voxel_size
    if facts.threshold >= _FINE * voxel:
        return ""
    wider = f"an inlier_threshold of about {meters(1.5 * voxel)} (now {meters(facts.threshold)})"
    return f"{wider}: points averaged over voxels of {meters(voxel)} lie farther apart than that"


def _features(facts: Facts) -> str:
    if facts.stages is None or facts.radius is None or min(facts.stages.points) == 0:
        return ""
    count, whole = min(
        zip(facts.stages.described, facts.stages.points, strict=True), key=lambda pair: pair[0] / pair[1]
    )
    if count >= _FEW_FEATURES * whole:
        return ""
    wider = f"a larger radius of the descriptors (now {meters(facts.radius)})"
    return f"{wider}: only {share(count, whole)} points have a feature"


def _matches(facts: Facts) -> str:
    most = max((proposal.matches for proposal in facts.stages.proposals), default=0) if facts.stages else facts.matches
    if most >= _FEW_MATCHES:
        return ""
    return f"{_more_matches(facts.options)}: there are only {most:,} matches"


def _more_matches(options: RegistrationOptions | None) -> str:
    if options is None:
        return "more matches, as of a larger match_neighbors"
    if options.ratio is not None:
        return f"ratio=None (now {options.ratio:g})"
    neighbors = f"a larger match_neighbors (now {options.match_neighbors})"
    return neighbors if options.effort == "thorough" else f'effort="thorough" (now "{options.effort}"), or {neighbors}'


def _hypotheses(facts: Facts) -> str:
    if facts.drawn == 0 or facts.scored > 0:
        return ""
    solver = None if facts.options is None else facts.options.solver
    lower = f"a lower edge_similarity (now {solver.edge_similarity:g}) or " if isinstance(solver, RansacOptions) else ""
    return f"{lower}a larger inlier_threshold: of {facts.drawn:,} hypotheses none was scored"


def _inliers(facts: Facts) -> str:
    if facts.matches == 0 or facts.inliers >= _FEW_INLIERS * facts.matches:
        return ""
    if facts.options is None or facts.radius is None:
        return ""
    agree = f"only {share(facts.inliers, facts.matches)} matches agree"
    if facts.options.effort == "thorough":
        wider = f"a larger radius of the descriptors (now {meters(facts.radius)})"
        return f"{wider}, for features that tell more places apart: {agree}"
    return f'effort="thorough" (now "{facts.options.effort}"), which tries more features and both solvers: {agree}'


def _colors(facts: Facts) -> str:
    if facts.options is None or (facts.colored and any(record.needs_colors for record in facts.options.descriptors)):
        return ""
    if not facts.colored:
        return "clouds with colors, which tell places of the same shape apart: geometry alone was matched"
    return "descriptors of color, such as Contrast and Pcfh: geometry alone was matched"


def _viewpoint(facts: Facts) -> str:
    if facts.options is None or not facts.unknown_viewpoints:
        return ""
    sides = " and the ".join(facts.unknown_viewpoints)
    if facts.assumed_viewpoints == facts.unknown_viewpoints:
        return f'the place of the scanner, as viewpoint ("origin" for the zero): it is only assumed for the {sides}'
    return f"the place of the scanner, as viewpoint: it is not known for the {sides}"


def _context(facts: Facts) -> str:
    if facts.margin is None or facts.margin >= _CLOSE_MARGIN:
        return ""
    now = "" if facts.radius is None else f" (now {meters(facts.radius)})"
    wider = f"a larger radius of the descriptors{now} or voxel_size, which takes in more of the surroundings"
    return f"{wider}: the odds over the runner-up are {odds(facts.margin)}"


def _overlap(facts: Facts) -> str:
    if facts.overlap is None or facts.overlap >= _LITTLE_OVERLAP:
        return ""
    return f"scans from places nearer to each other, or cut to what both see: they share only {percent(facts.overlap)}"


def _strength(facts: Facts) -> str:
    if facts.strength is None or facts.strength >= FIRM_STRENGTH:
        return ""
    return f"larger scans, with surfaces across the one along which the pose slides: strength {decimal(facts.strength)}"


def _conflict(facts: Facts) -> str:
    conflict = facts.candidates[0].conflict if facts.candidates else 0.0
    if not conflict > _MUCH_CONFLICT:
        return ""
    return f"correct viewpoints, and clouds without what moved: {percent(conflict)} stand where free space was seen"


def _normals(facts: Facts) -> str:
    cosine = facts.candidates[0].normals if facts.candidates else 1.0
    if facts.options is None or not cosine < _POOR_NORMALS:
        return ""
    now = meters(facts.options.normal_radius)
    return f"a larger normal_radius (now {now}): the normals of partners agree by {decimal(cosine)} only"


def _light(facts: Facts) -> str:
    correlation = facts.candidates[0].colors if facts.candidates else 1.0
    if not correlation < _POOR_COLORS:
        return ""
    apart = f"the colors of partners correlate by {decimal(correlation)} only"
    return f"geometry alone, by options.without_color(), where light or cameras differ: {apart}"


_Rule = Callable[[Facts], str]

CLOUD_RULES: dict[str, tuple[_Rule, ...]] = {
    "too few points": (_points,),
    "not finite": (),
    "too wide": (_voxels,),
    "degenerate": (),
    "units": (_units,),
}
"""By kind of failure, for clouds that cannot be registered with any setting; no other rule is asked then."""

IMPOSTOR_RULES: dict[str, tuple[_Rule, ...]] = {
    "mirrored": (_handedness,),
    "scaled": (_scale,),
}
"""By kind of failure, for pairs that no rigid transform explains: no setting helps, and no other rule is asked."""

FIRST_RULES: dict[str, tuple[_Rule, ...]] = {
    "too few matches": (_features, _matches),
    "no hypothesis": (_hypotheses, _matches),
    "no consensus": (_threshold, _features, _matches, _inliers),
    "ambiguous": (_colors, _viewpoint, _context),
    "sliding": (_strength, _overlap),
    "little overlap": (_threshold, _overlap),
    "free-space conflict": (_conflict, _viewpoint),
    "surfaces disagree": (_normals, _threshold, _viewpoint),
    "colors disagree": (_light,),
}
"""By kind of failure, the rules that come before the general ones."""

_GENERAL_RULES: tuple[_Rule, ...] = (
    *(_points, _threshold, _features, _matches, _hypotheses),
    *(_overlap, _context, _colors, _viewpoint, _strength, _inliers),
)
