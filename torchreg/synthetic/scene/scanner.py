"""A terrestrial laser scanner on a tripod: one colored scan of a scene, in the scanner's own frame.

Rays leave at equal steps of azimuth and elevation. What comes back depends on how dark, how far and how
slanted the surface is; the range carries noise along the ray; a few rays at depth edges hit two surfaces at once
and return a point between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from torchreg.open3d_loader import load_open3d
from torchreg.synthetic.scene import Array
from torchreg.synthetic.scene.light import Camera, Light, develop, irradiance, linear
from torchreg.synthetic.scene.paint import albedo
from torchreg.synthetic.scene.quads import Quads, yaw_rotation
from torchreg.types.clouds import Clouds


@dataclass(frozen=True, kw_only=True)
class LaserScanner:
    """Properties of a scanner."""

    angular_step: float = 0.4  # degrees between neighboring rays, in azimuth and in elevation
    lowest: float = -60.0  # degrees of elevation; below is the blind cone with the tripod in it
    highest: float = 90.0  # degrees of elevation
    min_range: float = 0.6  # meters
    max_range: float = 60.0  # meters
    sensitivity: float = 1.0  # 1 finds gray walls that face it up to some 40 m away; four times as much, twice as far
    range_noise: float = 0.004  # meters, standard deviation on a surface 10 m away that faces the scanner
    mixed_share: float = 0.15  # how many of the rays at a depth edge return a point between both surfaces
    depth_edge: float = 0.1  # meters between neighboring rays from which on they count as a depth edge


def scan(
    caster: Raycaster,
    light: Light,
    camera: Camera,
    T_world_scanner: Array,
    scanner: LaserScanner,
    seed: tuple[int, ...],
) -> Clouds:
    """One cloud of the points of a scene that come back to a scanner at its pose (4, 4), float64.

    ``caster`` holds the scene, which many scans may share, in meters and in the frame of the world. The points are
    ordered by elevation from below and then by azimuth: float32, meters, in the frame of the scanner, with colors in
    steps of 1/255. All noise comes from the seed; how large it is does not change which draws are made.
    """
    rng = np.random.default_rng(seed)
    rays = ray_directions(scanner)  # (E, A, 3)
    grid = rays.shape[:2]
    rays = rays.reshape(-1, 3)
    directions = rays @ T_world_scanner[:3, :3].T
    station = T_world_scanner[:3, 3]
    reach, quad, uv, normals = caster.cast(station, directions)
    hit = np.isfinite(reach)
    reach = np.where(hit, reach, 0.0)

    cosine = -(normals * directions).sum(axis=1)
    normals = np.where(cosine[:, None] < 0, -normals, normals)
    cosine = np.abs(cosine)
    places = station + reach[:, None] * directions + 2e-3 * normals
    paint = caster.paint.take(quad)
    surface = linear(albedo(paint, uv))
    radiance = surface * (irradiance(places, normals, light, caster) + paint.glow[:, None])

    came_back = hit & _strong_enough(scanner.sensitivity * (0.15 + surface.mean(axis=1)) * cosine, reach, rng)
    came_back &= (reach >= scanner.min_range) & (reach <= scanner.max_range)
    ranges, radiance = _mix_at_edges(reach, radiance, came_back, grid, scanner, rng)
    slant = 1 / np.sqrt(np.clip(cosine, 0.1, 1))
    deviation = scanner.range_noise * (0.4 + 0.06 * reach) * slant
    ranges = ranges + deviation * rng.standard_normal(len(ranges))
    colors = develop(radiance, camera, rng)
    points = ranges[came_back, None] * rays[came_back]
    return Clouds(
        points=torch.from_numpy(points.astype(np.float32)),
        colors=torch.from_numpy(colors[came_back]).to(torch.float32) / 255,
        viewpoint=torch.zeros(1, 3),
    )


def ray_directions(scanner: LaserScanner) -> Array:
    """Unit vectors (E, A, 3) in the scanner's frame: rows of elevation from below, columns of azimuth."""
    azimuth = np.deg2rad(np.arange(0.0, 360.0 - 1e-9, scanner.angular_step))
    elevation = np.arange(scanner.lowest, scanner.highest + 1e-9, scanner.angular_step)
    elevation = np.deg2rad(elevation)[:, None]
    flat = np.cos(elevation)
    up = np.broadcast_to(np.sin(elevation), (len(elevation), len(azimuth)))
    return np.stack((flat * np.cos(azimuth), flat * np.sin(azimuth), up), axis=-1)


def pose(position: Array, yaw: float, tilt: float, tilt_heading: float) -> Array:
    """``T_world_scanner`` (4, 4) at ``position`` (3,), meters: turned by ``yaw`` about the plumb line, then tilted.

    The scanner's axis leans from the plumb line by ``tilt`` towards the azimuth ``tilt_heading``; all in radians.
    """
    heading = yaw_rotation(np.array([tilt_heading]))[0]
    cosine, sine = np.cos(tilt), np.sin(tilt)
    lean = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
    T_world_scanner = np.eye(4)
    T_world_scanner[:3, :3] = heading @ lean @ heading.T @ yaw_rotation(np.array([yaw]))[0]
    T_world_scanner[:3, 3] = position
    return T_world_scanner


class Raycaster:
    """Rays and lines of sight among quads, by Open3D's RaycastingScene (Embree)."""

    def __init__(self, quads: Quads) -> None:
        self._core: Any = load_open3d().core
        self._scene: Any = load_open3d().t.geometry.RaycastingScene()
        self._uv, self.paint = quads.uv, quads.paint
        first = 4 * np.arange(len(quads))[:, None, None]
        triangles = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)  # (2Q, 3)
        corners = np.ascontiguousarray(quads.corners.reshape(-1, 3), dtype=np.float32)
        triangles = np.ascontiguousarray(triangles, dtype=np.uint32)
        self._scene.add_triangles(self._core.Tensor(corners), self._core.Tensor(triangles))

    def cast(self, origin: Array, directions: Array) -> tuple[Array, Array, Array, Array]:
        """Ranges (P,), inf for a miss; quad hit (P,); texture coordinates (P, 2); unit normals (P, 3)."""
        hits = self._scene.cast_rays(self._rays(origin, directions))
        reach = hits["t_hit"].numpy().astype(np.float64)
        triangle = np.where(np.isfinite(reach), hits["primitive_ids"].numpy(), 0).astype(np.int64)
        quad = triangle // 2
        b, c = hits["primitive_uvs"].numpy().astype(np.float64).T[:, :, None]
        second = (triangle % 2)[:, None] == 1
        corner = self._uv[quad]  # (P, 4, 2)
        middle, last = (np.where(second, corner[:, k + 1], corner[:, k]) for k in (1, 2))
        uv = (1 - b - c) * corner[:, 0] + b * middle + c * last
        return reach, quad, uv, hits["primitive_normals"].numpy().astype(np.float64)

    def reaches(self, points: Array, goals: Array) -> Array:
        """Whether nothing lies between the points (P, 3) and their goals, (3,) or (P, 3); (P,) bool."""
        occluded = self._scene.test_occlusions(self._rays(points, goals - points), tnear=0.0, tfar=0.98)
        return ~np.asarray(occluded.numpy())

    def escapes(self, points: Array, direction: Array) -> Array:
        """Whether nothing lies in the direction ``direction`` (3,) of the points (P, 3); (P,) bool."""
        return ~np.asarray(self._scene.test_occlusions(self._rays(points, direction)).numpy())

    def _rays(self, origins: Array, directions: Array) -> Any:  # noqa: ANN401  # an Open3D tensor
        shape = np.broadcast_shapes(origins.shape, directions.shape)
        rays = np.concatenate((np.broadcast_to(origins, shape), np.broadcast_to(directions, shape)), axis=1)
        return self._core.Tensor(np.ascontiguousarray(rays, dtype=np.float32))


def _strong_enough(returned: Array, reach: Array, rng: np.random.Generator) -> Array:
    """Whether enough light comes back, (P,) bool: little does from far, dark and slanted surfaces."""
    strength = returned * (20 / np.clip(reach, 5, None)) ** 2
    threshold = 0.05 * np.exp(0.5 * rng.standard_normal(len(reach)))
    return np.asarray((strength > threshold) & (rng.random(len(reach)) > 0.005))


def _mix_at_edges(
    reach: Array,
    radiance: Array,
    came_back: Array,
    grid: tuple[int, ...],
    scanner: LaserScanner,
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Blend a share of the rays with their neighbor in azimuth, where the two differ in depth."""
    beside = np.roll(np.arange(len(reach)).reshape(grid), -1, axis=1).ravel()
    both = came_back & came_back[beside]
    edge = both & (np.abs(reach[beside] - reach) > scanner.depth_edge)
    chosen = edge & (rng.random(len(reach)) < scanner.mixed_share)
    weight = np.where(chosen, rng.random(len(reach)), 0.0)
    ranges = reach + weight * (reach[beside] - reach)
    return ranges, radiance + weight[:, None] * (radiance[beside] - radiance)
