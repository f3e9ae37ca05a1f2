"""The registration's options: a preset, and what the command line says over it."""

from __future__ import annotations

from dataclasses import dataclass, fields

from torchreg.cli import options as opt
from torchreg.preprocess import voxel_downsample
from torchreg.registration import PAPER, derive_options
from torchreg.registration.options import RegistrationOptions
from torchreg.registration.overrides import OptionOverrides
from torchreg.registration.spacing import options_of_spacings, spacing, usable
from torchreg.types import Clouds


@dataclass(frozen=True, kw_only=True)
class Overrides:
    """A preset, and what was given over it; ``None`` where nothing was. Lengths in meters.

    Raises:
        ValueError: a value that ``RegistrationOptions`` would refuse.
    """

    preset: opt.PresetName = opt.Preset.default
    voxel: opt.Voxel = None
    normal_radius: opt.NormalRadius = None
    feature_radius: opt.FeatureRadius = None
    color_radius: opt.ColorRadius = None
    inlier_threshold: opt.InlierThreshold = None
    hypotheses: opt.Hypotheses = None
    confidence: opt.Confidence = None
    no_color: opt.NoColor = False

    def __post_init__(self) -> None:
        self.said()

    def said(self) -> OptionOverrides:
        """What was given, without the preset."""
        return OptionOverrides(**{one.name: getattr(self, one.name) for one in fields(OptionOverrides)})

    def over(self, options: RegistrationOptions) -> RegistrationOptions:
        """The options with what was given in their place."""
        return self.said().over(options)


def options_for(source: Clouds, target: Clouds, overrides: Overrides) -> RegistrationOptions:
    """Options for one pair: the paper's, or derived from the spacing the points have once they are downsampled.

    A voxel size given with the default preset thus sets the scale of all lengths that are not given.
    """
    if overrides.preset is opt.Preset.paper:
        return overrides.over(PAPER)
    if overrides.voxel is None or not (usable(source) and usable(target)):
        return overrides.over(derive_options(source, target)[0])
    thinned = [voxel_downsample(cloud, overrides.voxel) for cloud in (source, target)]
    apart = (float(spacing(thinned[0])), float(spacing(thinned[1])))
    colored = source.colors is not None and target.colors is not None
    return overrides.over(options_of_spacings(apart, overrides.voxel, colored=colored))
