"""Owns what the shape of the lit water says where nothing else is lit: whether it lets light through at all.

In clear water a ray gathers light all along its way through the beam; where the water swallows light, only from where the
ray is nearest to both windows. So the glow's distribution over the picture tells the attenuation, roughly; nobody's albedo is
in it. The beam is taken as designed: half way between the cameras, with their field of view.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.optics.model import HousedCamera, StereoRig
from appliance.verdict.turbidity_beam import Beam, gather

Array = NDArray[np.float64]

LEAST_GLOW_DN = 0.25
"""Mean over the picture: fainter, its shape is noise."""
CANDIDATES_PER_M = np.arange(0.0, 12.01, 0.25)
FAR_MM = 1500.0
"""Where rays end that meet nothing."""
NOISE_DN, SHAPE_SHARE = 0.12, 0.06
"""How well a cell's mean is known, and how far the design's beam is believed."""
MIN_CELLS = 60


def shape_of_glow(glow_dn: Array, cells: tuple[int, int], rig: StereoRig, water_index: float) -> float | None:
    """Attenuation per metre that explains the left camera's ``glow_dn`` (cells[0] · cells[1],) best; ``None``: too little light."""
    known = np.isfinite(glow_dn)
    if np.count_nonzero(known) < MIN_CELLS or float(np.mean(glow_dn[known])) < LEAST_GLOW_DN:
        return None
    camera = rig.left
    row, column = np.divmod(np.arange(cells[0] * cells[1]), cells[0])
    u = (column + 0.5) * camera.width_px / cells[0] - 0.5
    v = (row + 0.5) * camera.height_px / cells[1] - 0.5
    origins, directions = camera.rays(np.stack([u, v], -1)[known], water_index)
    gathered = gather(_beam(rig, water_index), origins, directions, np.full(len(origins), FAR_MM))
    seen = glow_dn[known]
    weight = 1.0 / (NOISE_DN**2 + (SHAPE_SHARE * np.maximum(seen, 0.0)) ** 2)
    misfit = []
    for per_m in CANDIDATES_PER_M:
        model = gathered.veil(float(per_m))
        scale = float(np.sum(weight * model * seen) / max(float(np.sum(weight * model * model)), 1e-300))
        misfit.append(float(np.sum(weight * (seen - scale * model) ** 2)))
    return float(CANDIDATES_PER_M[int(np.argmin(misfit))])


def _beam(rig: StereoRig, water_index: float) -> Beam:
    """As drawn: the projector half way between the cameras, aimed at the volume's middle, with the left camera's field."""
    between = np.asarray(rig.right.translation_mm)
    middle = 0.5 * between
    x = between / np.linalg.norm(between)
    towards = rig.volume_centre_mm(water_index) - middle
    z = towards - x * (x @ towards)
    z /= np.linalg.norm(z)
    port = rig.left.port
    face_mm = port.distance_mm + port.thickness_mm
    depth_mm = water_index * (port.distance_mm + port.thickness_mm / port.glass_index)
    across, down = half_field(rig.left, water_index)
    axes = np.stack([x, np.cross(z, x), z])
    return Beam(axes, middle + z * (face_mm - depth_mm), depth_mm, -across, across, -down, down)


def half_field(camera: HousedCamera, water_index: float) -> tuple[float, float]:
    """Tangents of half the angles of view in the water."""
    u, v = (camera.width_px - 1) / 2.0, (camera.height_px - 1) / 2.0
    edges = np.array([[0.0, v], [2.0 * u, v], [u, 0.0], [u, 2.0 * v]])
    _, d = camera.rays(edges, water_index)
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    across, down = (float(np.arccos(np.clip(d[k] @ d[k + 1], -1.0, 1.0))) for k in (0, 2))
    return float(np.tan(0.5 * across)), float(np.tan(0.5 * down))
