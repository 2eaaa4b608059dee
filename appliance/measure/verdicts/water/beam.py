"""The backscatter of each camera ray, by single scattering of the projector's beam.

The projector is half way between the cameras and points at the middle of the volume. The angles of its beam follow from
the points of a scan and their pattern coordinates; without points, it is nominal, with the cameras' field of view.

If only water is illuminated, the shape of the backscatter in the image gives a rough attenuation. In clear water a ray
gathers light all along the beam; in turbid water only where it is nearest to both ports. This shape does not depend on
an albedo. An object that the water blurs beyond recognition adds light that is smooth and flattens the shape; that
light is fitted as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.model import HousedCamera, StereoRig

Array = NDArray[np.float64]

NODES = 24
"""Nodes of the integral along a ray through the beam (Gauss and Legendre); 48 change it by less than 0.1 %."""
_PLACES, _SHARES = np.polynomial.legendre.leggauss(NODES)
SCALE_MM = 500.0
"""Path in mm at which the brightness of the beam is 1."""


@dataclass(frozen=True, slots=True)
class ProjectorBeam:
    """The projector's beam in the water, in its own frame of reference.

    x is along the baseline, z into the water; the origin is the light's apparent start.
    """

    to_beam: Array
    """(3, 3) rows: its axes in the left camera frame."""
    start_mm: Array
    """(3,): the light's apparent start in the left camera frame."""
    depth_mm: float
    """Distance from there to the port's outer face."""
    x_from: float
    x_to: float
    y_from: float
    y_to: float
    """Tangents of its borders."""


@dataclass(frozen=True, slots=True)
class GatheredLight:
    """Light that n rays gather: ``weights @ exp(−attenuation · path_m)``, row by row.

    Its unit is mm of water that is illuminated as at ``SCALE_MM``.
    """

    weights: Array
    """(n, NODES)."""
    path_m: Array
    """(n, NODES): from port to port by way of each node."""
    enters_mm: Array
    """(n,): distance from the projector's port at which the ray enters the beam."""
    falls: Array
    """(n,): brightness of the beam at the end of the ray, 1 at ``SCALE_MM`` on its axis."""
    ends_m: Array
    """(n,): the path by way of the end of the ray."""

    def backscatter(self, attenuation_per_m: float) -> Array:
        """Return the backscatter of each ray, (n,)."""
        return np.asarray((self.weights * np.exp(-attenuation_per_m * self.path_m)).sum(1))

    def slope(self, attenuation_per_m: float) -> Array:
        """Return the derivative (n,) of ``backscatter`` by the attenuation."""
        return -np.asarray((self.weights * self.path_m * np.exp(-attenuation_per_m * self.path_m)).sum(1))


def beam_of(
    rig: StereoRig, water_index: float, points_mm: Array, pattern_px: Array, size_px: tuple[int, int]
) -> ProjectorBeam | None:
    """Fit the beam to points (n, 3) and pattern coordinates (n, 2); ``None``: they span no beam."""
    between = np.asarray(rig.right.translation_mm)
    middle = 0.5 * between
    x = between / np.linalg.norm(between)
    towards = rig.volume_centre_mm(water_index) - middle
    z = towards - x * (x @ towards)
    z /= np.linalg.norm(z)
    axes = np.stack([x, np.cross(z, x), z])
    port = rig.left.port
    face_mm = port.distance_mm + port.thickness_mm
    depth_mm = water_index * (port.distance_mm + port.thickness_mm / port.glass_index)
    start = middle + z * (face_mm - depth_mm)
    local = (points_mm - start) @ axes.T
    tangents = local[:, :2] / local[:, 2:]
    borders: list[float] = []
    for k, size in enumerate(size_px):
        t, px = tangents[:, k], pattern_px[:, k]
        spread = float(np.var(t))
        # Pattern px are linear in the tangent: the line's ends at the first and the last px are the beam's borders.
        per_tangent = float(np.mean((t - t.mean()) * (px - px.mean()))) / spread if spread > 1e-6 else 0.0
        if per_tangent <= 0.0:
            return None
        offset = float(px.mean()) - per_tangent * float(t.mean())
        borders += [(-0.5 - offset) / per_tangent, (size - 0.5 - offset) / per_tangent]
    return ProjectorBeam(axes, start, depth_mm, *borders)


def gather(beam: ProjectorBeam, origins_mm: Array, directions: Array, ends_mm: Array) -> GatheredLight:
    """Integrate along rays (n, 3) in the left camera frame, from their port to ``ends_mm`` (n,)."""
    o = (origins_mm - beam.start_mm) @ beam.to_beam.T
    d = directions @ beam.to_beam.T
    first = np.maximum((beam.depth_mm - o[:, 2]) / d[:, 2], 0.0)
    last = np.array(ends_mm, np.float64)
    # Clip the ray to the beam, border plane by border plane.
    for axis, border, sign in (
        (0, beam.x_from, 1.0),
        (0, beam.x_to, -1.0),
        (1, beam.y_from, 1.0),
        (1, beam.y_to, -1.0),
    ):
        inside = sign * (o[:, axis] - border * o[:, 2])
        gains = sign * (d[:, axis] - border * d[:, 2])
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = -inside / gains
        first = np.where(gains > 0.0, np.maximum(first, crossing), first)
        last = np.where(gains < 0.0, np.minimum(last, crossing), last)
        last = np.where((gains == 0.0) & (inside < 0.0), first, last)
    last = np.maximum(last, first)
    # Gauss and Legendre nodes from −1..1 to the part of the ray that lies in the beam.
    along = first[:, None] + (last - first)[:, None] * 0.5 * (_PLACES + 1.0)
    bright, path_mm = _light(beam, o[:, None] + along[..., None] * d[:, None])
    ends, far_mm = _light(beam, o + np.asarray(ends_mm)[:, None] * d)
    enters = o[:, 2] + first * d[:, 2] - beam.depth_mm
    weights = bright * (0.5 * (last - first)[:, None] * _SHARES)
    return GatheredLight(weights, (path_mm + along) / 1000.0, enters, ends, (far_mm + ends_mm) / 1000.0)


def _light(beam: ProjectorBeam, point_mm: Array) -> tuple[Array, Array]:
    """Return brightness and path in mm of the beam at points (..., 3) of its frame, in clear water.

    The path begins at the projector's port.
    """
    distance_mm = np.linalg.norm(point_mm, axis=-1)
    cosine = point_mm[..., 2] / distance_mm
    path = distance_mm - beam.depth_mm / cosine
    # Inverse square from the apparent start, and cos⁴ of the angle from the beam's axis.
    spread = (SCALE_MM + beam.depth_mm) / distance_mm
    return spread * spread * cosine**4, path


LEAST_GLOW_DN = 0.25
"""Least mean over the image; below, its shape is noise."""
CANDIDATES_PER_M = np.arange(0.0, 12.01, 0.25)
FAR_MM = 1500.0
"""Length of rays that meet no object."""
NOISE_DN, SHAPE_SHARE = 0.12, 0.06
"""Standard deviations of a cell's mean, and of the nominal beam as a share of its backscatter."""
MIN_CELLS = 60
MOST_OF_OBJECT = 0.25
"""Largest share of the light that may be that of an object whose fringes are lost."""


def shape_of_glow(glow_dn: Array, cells: tuple[int, int], rig: StereoRig, water_index: float) -> float | None:
    """Return the attenuation, 1/m, that fits the left camera's backscatter best; ``None``: too faint.

    ``glow_dn``: (cells[0] · cells[1],). A surface of any brightness across the middle of the volume is fitted as well:
    in turbid water an object may send back light without visible fringes. If this were more than ``MOST_OF_OBJECT`` of
    the light, the unknown shape of the object would decide, and the backscatter is fitted alone.
    """
    is_known = np.isfinite(glow_dn)
    if np.count_nonzero(is_known) < MIN_CELLS or float(np.mean(glow_dn[is_known])) < LEAST_GLOW_DN:
        return None
    camera = rig.left
    row, column = np.divmod(np.arange(cells[0] * cells[1]), cells[0])
    u = (column + 0.5) * camera.width_px / cells[0] - 0.5
    v = (row + 0.5) * camera.height_px / cells[1] - 0.5
    origins, directions = camera.rays(np.stack([u, v], -1)[is_known], water_index)
    beam = _beam(rig, water_index)
    gathered = gather(beam, origins, directions, np.full(len(origins), FAR_MM))
    middle_mm = (float(rig.volume_centre_mm(water_index)[2]) - origins[:, 2]) / directions[:, 2]
    surface = gather(beam, origins, directions, middle_mm)
    observed = glow_dn[is_known]
    weight = 1.0 / (NOISE_DN**2 + (SHAPE_SHARE * np.maximum(observed, 0.0)) ** 2)
    alone: list[float] = []
    beside: list[tuple[float, float]] = []
    for per_m in CANDIDATES_PER_M:
        model = gathered.backscatter(float(per_m))
        alone.append(_fit(model[:, None], observed, weight)[1])
        models = np.stack([model, surface.falls * np.exp(-per_m * surface.ends_m)], -1)
        parts, misfit = _fit(models, observed, weight)
        beside.append((misfit, float(models[:, 1].sum() * parts[1] / max((models @ parts).sum(), 1e-300))))
    best = min(range(len(beside)), key=lambda k: beside[k][0])
    if beside[best][1] > MOST_OF_OBJECT:
        best = int(np.argmin(alone))
    return float(CANDIDATES_PER_M[best])


def _fit(models: Array, observed: Array, weight: Array) -> tuple[Array, float]:
    """Fit ``observed`` (n,) by non-negative parts of the columns of ``models`` (n, 1 or 2).

    Returns the parts and the weighted sum of squared residuals.
    """
    scale = np.maximum(np.sqrt(np.einsum("n,nk,nk->k", weight, models, models)), 1e-300)
    root = np.sqrt(weight)
    parts = np.linalg.lstsq(root[:, None] * models / scale, root * observed, rcond=None)[0]
    if len(parts) == 2 and parts.min() < 0.0:
        # Non-negative least squares leave out one of two columns: the one that explains less alone.
        single = np.maximum((root[:, None] * models / scale).T @ (root * observed), 0.0)
        parts = np.where(single == single.max(), single, 0.0)
    parts = parts / scale
    return parts, float(np.sum(weight * (observed - models @ parts) ** 2))


def _beam(rig: StereoRig, water_index: float) -> ProjectorBeam:
    """Return the nominal beam.

    The projector is half way between the cameras, points at the middle of the volume, and has the left camera's field.
    """
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
    return ProjectorBeam(axes, middle + z * (face_mm - depth_mm), depth_mm, -across, across, -down, down)


def half_field(camera: HousedCamera, water_index: float) -> tuple[float, float]:
    """Return the tangents of half the angles of view in the water."""
    u, v = (camera.width_px - 1) / 2.0, (camera.height_px - 1) / 2.0
    edges = np.array([[0.0, v], [2.0 * u, v], [u, 0.0], [u, 2.0 * v]])
    _, d = camera.rays(edges, water_index)
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    across, down = (float(np.arccos(np.clip(d[k] @ d[k + 1], -1.0, 1.0))) for k in (0, 2))
    return float(np.tan(0.5 * across)), float(np.tan(0.5 * down))
