"""Rays against painted quads."""

from __future__ import annotations

from typing import Any

import numpy as np

from torchreg.open3d_loader import load_open3d
from torchreg.synthetic.scene.arrays import Array
from torchreg.synthetic.scene.quads import Quads


class Raycaster:
    """Rays against quads, by Open3D's RaycastingScene (Embree)."""

    def __init__(self, quads: Quads) -> None:
        self._core: Any = load_open3d().core
        self._scene: Any = load_open3d().t.geometry.RaycastingScene()
        self._uv = quads.uv
        first = 4 * np.arange(len(quads))[:, None, None]
        triangles = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)  # (2Q, 3)
        corners = np.ascontiguousarray(quads.corners.reshape(-1, 3), dtype=np.float32)
        triangles = np.ascontiguousarray(triangles, dtype=np.uint32)
        self._scene.add_triangles(self._core.Tensor(corners), self._core.Tensor(triangles))

    def cast(self, origin: Array, ways: Array) -> tuple[Array, Array, Array, Array]:
        """Ranges (P,), inf for a miss; quad hit (P,); texture coordinates (P, 2); unit normals (P, 3)."""
        answer = self._scene.cast_rays(self._rays(origin, ways))
        reach = answer["t_hit"].numpy().astype(np.float64)
        triangle = np.where(np.isfinite(reach), answer["primitive_ids"].numpy(), 0).astype(np.int64)
        quad = triangle // 2
        b, c = answer["primitive_uvs"].numpy().astype(np.float64).T[:, :, None]
        second = (triangle % 2)[:, None] == 1
        corner = self._uv[quad]  # (P, 4, 2)
        middle, last = (np.where(second, corner[:, k + 1], corner[:, k]) for k in (1, 2))
        uv = (1 - b - c) * corner[:, 0] + b * middle + c * last
        return reach, quad, uv, answer["primitive_normals"].numpy().astype(np.float64)

    def reaches(self, points: Array, goals: Array) -> Array:
        """Whether nothing stands between the points (P, 3) and their goals, (3,) or (P, 3); (P,) bool."""
        occluded = self._scene.test_occlusions(self._rays(points, goals - points), tnear=0.0, tfar=0.98)
        return ~np.asarray(occluded.numpy())

    def escapes(self, points: Array, way: Array) -> Array:
        """Whether nothing stands in the direction ``way`` (3,) of the points (P, 3); (P,) bool."""
        return ~np.asarray(self._scene.test_occlusions(self._rays(points, way)).numpy())

    def _rays(self, origins: Array, ways: Array) -> Any:  # noqa: ANN401  # an Open3D tensor
        shape = np.broadcast_shapes(origins.shape, ways.shape)
        rays = np.concatenate((np.broadcast_to(origins, shape), np.broadcast_to(ways, shape)), axis=1)
        return self._core.Tensor(np.ascontiguousarray(rays, dtype=np.float32))
