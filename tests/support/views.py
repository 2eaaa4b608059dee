"""Owns what an ideal scan of a simulated object is: its points on the pixel grid with noise drawn along the rays, painted and lit.

The shapes and their paint are the simulated world's, the rays those of a calibrated camera in water: no frames are made, so that
a view takes a tenth of a second and its place is known exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.calibration.file import Calibration
from appliance.measure.overlap.pair import ReadyScan, ready_with
from appliance.measure.overlap.patches import projection_of
from appliance.measure.overlap.rigid import Rigid
from appliance.measure.points.organised import OrganisedCloud
from hw_sim.objects import shapes, texture
from hw_sim.objects.motion import pose_matrix
from tests.support import synthetic

CALIBRATION = synthetic.calibration(400, 300)
LIGHT_MM = 0.5 * np.asarray(CALIBRATION.rig.right.translation_mm)
PROJECTION = projection_of(CALIBRATION.rig.left, synthetic.WATER.index)
SIGMA_MM = 0.025
SIZES = np.zeros(shapes.SIZES)
SIZES[shapes.HALF_BALL_DISTANCE], SIZES[shapes.BOARD_SCALE] = 75.0, 1.0
Array = NDArray[np.float64]


@dataclass(frozen=True)
class SeenView:
    """A view and where it was taken from."""

    cloud: OrganisedCloud
    place: Rigid
    """From the view's frame into the object's."""

    def ready(self) -> ReadyScan:
        return ready_with(self.cloud, PROJECTION, LIGHT_MM)


def view(
    name: str, pose: tuple[float, ...], paint: str = "slight", seed: int = 1, calibration: Calibration = CALIBRATION
) -> SeenView:
    """What the left camera of ``calibration`` sees of an object at ``pose`` [x, y, z, rx_deg, ry_deg, rz_deg] in its frame; ``paint``: one
    of the simulated world's textures."""
    camera = calibration.rig.left
    v, u = np.mgrid[0 : camera.height_px, 0 : camera.width_px].astype(float)
    origin, direction = camera.rays(np.stack([u, v], -1).reshape(-1, 2), synthetic.WATER.index)
    R, t = pose_matrix(pose)
    rays = np.concatenate([(origin - t) @ R, direction @ R], axis=1)
    reach = np.empty(len(rays))
    kind = shapes.NAMES[name]
    shapes.march_all(kind, SIZES, np.ascontiguousarray(rays), reach)
    hit = np.flatnonzero(np.isfinite(reach))
    at = rays[hit, :3] + reach[hit, None] * rays[hit, 3:]
    rng = np.random.default_rng(seed)
    lattice = texture.noise_lattice()
    normal = _normals(kind, at)
    to_light = (LIGHT_MM - t) @ R - at
    away = np.linalg.norm(to_light, axis=1)
    cosine = np.clip((normal * to_light).sum(1) / away, 0.0, 1.0)
    albedo = np.array([texture.albedo(texture.NAMES[paint], lattice, *p) for p in at])
    grey = 330.0 * albedo * cosine * (500.0 / away) ** 2
    grey = grey + rng.normal(size=len(grey)) * np.sqrt(0.3 + 0.01 * grey)
    seen = -(normal * rays[hit, 3:]).sum(1) > 0.2
    shape = (camera.height_px, camera.width_px)
    image = np.full(shape[0] * shape[1], 3, np.uint8)
    image[hit] = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
    points = np.full((*image.shape, 3), np.nan, np.float32)
    noise = SIGMA_MM * rng.normal(size=len(hit))
    points[hit[seen]] = (origin[hit] + (reach[hit] + noise)[:, None] * direction[hit])[seen]
    sigma = np.where(np.isfinite(points[:, 2]), np.float32(SIGMA_MM), np.float32(np.nan)).astype(np.float32)
    other = np.full(shape, np.nan, np.float32)
    cloud = OrganisedCloud(points.reshape(*shape, 3), sigma.reshape(shape), other, other, image.reshape(shape))
    return SeenView(cloud, Rigid(R.T, -R.T @ t))


def _normals(kind: int, at: Array) -> Array:
    """Unit normals (n, 3) of the surface at points (n, 3) of the object's frame, by central differences."""
    slope, h = np.empty((2, len(at))), 1e-4
    normal = np.empty_like(at)
    for axis in range(3):
        for side, sign in enumerate((-h, h)):
            moved = at.copy()
            moved[:, axis] += sign
            shapes.values(kind, SIZES, moved, slope[side])
        normal[:, axis] = slope[1] - slope[0]
    return np.asarray(normal / np.linalg.norm(normal, axis=1)[:, None])


def between(first: SeenView, second: SeenView) -> Rigid:
    """The true pose of ``second`` in the frame of ``first``."""
    return second.place.then(first.place.inverse)


def displacement_mm(pose: Rigid, true: Rigid, seen: SeenView) -> float:
    """RMS distance between where two poses put the points of a view."""
    points = seen.cloud.points_mm[seen.cloud.mask][::50].astype(np.float64)
    return float(np.sqrt(((pose.of(points) - true.of(points)) ** 2).sum(1).mean()))
