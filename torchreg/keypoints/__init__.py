"""Keypoints: some of the points of clouds, selected by their shape or spread evenly.

A new rule is a file with its record, and its name here.
"""

from torchreg.keypoints.farthest import FarthestKeypoints, farthest_keypoints
from torchreg.keypoints.iss import IssKeypoints, iss_keypoints
from torchreg.keypoints.keypoints import KeypointRows, Keypoints, KeypointSupport
from torchreg.keypoints.uniform import UniformKeypoints, uniform_keypoints

KEYPOINTS: dict[str, type[Keypoints]] = {
    record.name: record for record in (IssKeypoints, UniformKeypoints, FarthestKeypoints)
}
"""The rules of this package by name."""

__all__ = [
    "KEYPOINTS",
    "FarthestKeypoints",
    "IssKeypoints",
    "KeypointRows",
    "KeypointSupport",
    "Keypoints",
    "UniformKeypoints",
    "farthest_keypoints",
    "iss_keypoints",
    "uniform_keypoints",
]
