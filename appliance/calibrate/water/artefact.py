"""Owns an artefact at its unknown place: its parameters, where camera-1 rays meet it, and what its certificate adds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.recordings import ArtefactKind, Recording, RecordingError
from appliance.calibrate.water.shapes import fit_plane, fit_sphere, triangulate
from appliance.measure import StereoRig

Array = NDArray[np.float64]

STEEPEST_COSINE = 0.4
"""Rays that meet a sphere more grazingly than this say little about it and much about the matching: left out."""


@dataclass(frozen=True, slots=True)
class PlanePlace:
    """n·X = e, the normal leaning from ``normal`` along two axes. Parameters: two leans (rad), offset (mm)."""

    normal: Array
    axes: Array
    offset_mm: float

    steps = np.array([1e-5, 1e-5, 1e-3])

    def meet(self, origin: Array, direction: Array, sphere: NDArray[np.intp], x: Array) -> Array:
        """Return points (n, 3) where rays meet the face; ``sphere`` is of no meaning here."""
        # Two leans and an offset are a plane's three degrees of freedom; a third number for the normal would only be
        # its length.
        n = self.normal + x[0] * self.axes[0] + x[1] * self.axes[1]
        n = n / np.linalg.norm(n)
        s = (self.offset_mm + x[2] - origin @ n) / (direction @ n)
        return np.asarray(origin + s[:, None] * direction)

    def certificate(self, x: Array) -> tuple[Array, Array]:
        """No length is known: residuals (0,) and their Jacobian (0, 3)."""
        return np.empty(0), np.empty((0, 3))


@dataclass(frozen=True, slots=True)
class BarPlace:
    """Two spheres. Parameters: increments of both centres (6, mm) and of both radii (2, mm)."""

    centres_mm: Array
    radius_mm: float
    radius_sd_mm: float
    length_mm: float
    length_sd_mm: float

    steps = np.full(8, 1e-3)

    def meet(self, origin: Array, direction: Array, sphere: NDArray[np.intp], x: Array) -> Array:
        """Return points (n, 3) where rays first meet their sphere; a ray that misses gives its nearest point."""
        centre = (self.centres_mm + x[:6].reshape(2, 3))[sphere]
        radius = (self.radius_mm + x[6:8])[sphere]
        # |o + s d − c|² = r² is s² + 2 b s + |w|² − r² = 0; the nearer root is s = −b − √(b² − |w|² + r²). A negative
        # root is cut to zero, so that a ray that misses still pulls the sphere towards it.
        w = origin - centre
        b = np.sum(w * direction, -1)
        root = np.sqrt(np.maximum(b * b - np.sum(w * w, -1) + radius**2, 0.0))
        return np.asarray(origin - (b + root)[:, None] * direction)

    def certificate(self, x: Array) -> tuple[Array, Array]:
        """Return residuals (3,) of length and radii in standard deviations, and their Jacobian (3, 8)."""
        centres = self.centres_mm + x[:6].reshape(2, 3)
        bar = centres[1] - centres[0]
        length = float(np.linalg.norm(bar))
        # The certificate is one more observation with its own uncertainty, not a constraint: a length that does not fit
        # shows as a residual.
        residual = np.array(
            [(length - self.length_mm) / self.length_sd_mm, x[6] / self.radius_sd_mm, x[7] / self.radius_sd_mm]
        )
        jacobian = np.zeros((3, 8))
        jacobian[0, :3], jacobian[0, 3:6] = -bar / length / self.length_sd_mm, bar / length / self.length_sd_mm
        jacobian[1, 6] = jacobian[2, 7] = 1.0 / self.radius_sd_mm
        return residual, jacobian


Place = PlanePlace | BarPlace


def first_place(recording: Recording, rig: StereoRig) -> tuple[Place, Recording]:
    """Estimate the artefact's pose with ``rig``; return it and the recording without points of grazing sight.

    Raises RecordingError when the points do not look like the artefact at all.
    """
    water_index = recording.water.index
    points = triangulate(rig, recording.left_px, recording.right_px, water_index)
    if recording.kind is ArtefactKind.PLANE:
        normal, offset = fit_plane(points)
        across = np.cross([0.0, 1.0, 0.0], normal)
        across /= np.linalg.norm(across)
        return PlanePlace(normal, np.stack([across, np.cross(normal, across)]), offset), recording
    if recording.radius_mm is None or recording.length_mm is None:
        raise RecordingError(f"recording {recording.name}: a ball bar without length or radius; give the certificate's")
    centres = np.stack([fit_sphere(points[recording.sphere == k], recording.radius_mm)[0] for k in (0, 1)])
    length = float(np.linalg.norm(centres[1] - centres[0]))
    # Ports as drawn are wrong by per cents at most; ten are two other balls.
    if abs(length / recording.length_mm - 1.0) > 0.1:
        raise RecordingError(
            f"recording {recording.name}: the spheres seem {length:.1f} mm apart, the certificate says "
            f"{recording.length_mm:g} mm; check the certificate's length and which points belong to which sphere"
        )
    away = points - centres[recording.sphere]
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    seen_well = np.ones(len(points), bool)
    for camera in (rig.left, rig.right):
        sight = np.asarray(camera.translation_mm) - points
        sight /= np.linalg.norm(sight, axis=1, keepdims=True)
        seen_well &= np.sum(away * sight, -1) > STEEPEST_COSINE
    bar = BarPlace(centres, recording.radius_mm, recording.radius_sd_mm, recording.length_mm, recording.length_sd_mm)
    return bar, recording.select(seen_well)
