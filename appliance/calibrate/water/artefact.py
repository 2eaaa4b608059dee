"""Owns the pose of an artefact in a calibration in water: its first estimate, its parameters, and its residuals.

    triangulate, fit_plane, fit_sphere    the first estimate, from the matched pixels of a recording
    PlanePlace, BarPlace                  parameters of a plane or a ball bar: where a ray meets it, and the
                                          observations that its certificate adds
    first_place                           the first estimate as such parameters, without rays at grazing incidence
    residuals_of                          residuals of a recording in px; the pose is adjusted, the rig is not

The residual is the same for every calibration method. The ray of the left pixel is intersected with the artefact. That
point is projected into the right camera. The residual is its distance, in x and y, from the matched right pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.recordings import ArtefactKind, Recording, RecordingError, thinned
from appliance.measure import StereoRig

Array = NDArray[np.float64]

SPHERE_STEPS = 20


def triangulate(rig: StereoRig, left_px: Array, right_px: Array, water_index: float) -> Array:
    """Return points (n, 3), left camera frame, mm: the middles of the shortest lines between the rays of each pair."""
    return nearest_points(*rig.left.rays(left_px, water_index), *rig.right.rays(right_px, water_index))


def nearest_points(p: Array, a: Array, q: Array, b: Array) -> Array:
    """Return the middles (n, 3) of the shortest lines between rays p + s·a and q + t·b, unit directions."""
    # Minimise |p + s a − q − t b|²: two linear equations in s and t with determinant 1 − (a·b)².
    w = p - q
    cosine = np.sum(a * b, -1)
    da, db = np.sum(a * w, -1), np.sum(b * w, -1)
    det = 1.0 - cosine**2
    s = (cosine * db - da) / det
    t = (db - cosine * da) / det
    return np.asarray(0.5 * (p + s[:, None] * a + q + t[:, None] * b))


def fit_plane(points_mm: Array) -> tuple[Array, float]:
    """Return the unit normal n towards +z and offset e of the plane n·X = e nearest to points (n, 3)."""
    middle = points_mm.mean(axis=0)
    _, _, axes = np.linalg.svd(points_mm - middle, full_matrices=False)
    normal = axes[2] if axes[2][2] > 0.0 else -axes[2]
    return normal, float(normal @ middle)


def fit_sphere(points_mm: Array, radius_mm: float | None = None) -> tuple[Array, float]:
    """Return the centre and radius of the sphere nearest to points (n, 3) by orthogonal distance; the radius fixed if
    given."""
    middle = points_mm.mean(axis=0)
    local = points_mm - middle
    # Algebraic start: |X|² = 2 c·X + (r² − |c|²) is linear in c and r² − |c|². It is biased on a part of a sphere,
    # hence the orthogonal iteration below.
    design = np.column_stack([2.0 * local, np.ones(len(local))])
    solution, *_ = np.linalg.lstsq(design, np.sum(local**2, axis=1), rcond=None)
    centre = solution[:3]
    radius = float(np.sqrt(max(solution[3] + centre @ centre, 0.0)))
    if radius_mm is not None:
        radius = radius_mm
    for _ in range(SPHERE_STEPS):
        away = local - centre
        distance = np.linalg.norm(away, axis=1)
        jacobian = -away / distance[:, None]
        if radius_mm is None:
            jacobian = np.column_stack([jacobian, -np.ones(len(local))])
        step, *_ = np.linalg.lstsq(jacobian, radius - distance, rcond=None)
        centre = centre + step[:3]
        if radius_mm is None:
            radius += float(step[3])
        if float(np.abs(step).max()) < 1e-10:
            break
    return centre + middle, radius


STEPS_AT_MOST = 12
SMALL_PX = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """Residuals of one recording."""

    name: str
    left_px: Array
    """(n, 2)."""
    miss_px: Array
    """(n, 2), where the right camera should see it minus where it does."""

    @property
    def rms_px(self) -> float:
        """RMS residual per coordinate."""
        return float(np.sqrt(np.mean(self.miss_px**2)))


def residuals_of(recording: Recording, rig: StereoRig, points: int = 1500) -> Residuals:
    """Compute the residuals that ``rig`` leaves of a recording. Raises RecordingError when it does not look like its
    artefact."""
    place, used = first_place(thinned(recording, points), rig)
    index = used.water.index
    origin, direction = rig.left.rays(used.left_px, index)

    def miss(q: Array) -> Array:
        return rig.right.project(place.meet(origin, direction, used.sphere, q), index) - used.right_px

    q = np.zeros(len(place.steps))
    now = miss(q)
    for _ in range(STEPS_AT_MOST):
        # Only the artefact's pose is adjusted; the rig stays as it is. Gauss-Newton without damping: the start is
        # within tenths of a millimetre.
        J = np.stack([(miss(q + e) - now).ravel() / e.max() for e in np.diag(place.steps)], -1)
        known = np.isfinite(J).all(axis=1) & np.isfinite(now.ravel())
        # In units of a hundredth of a pixel, as matches are; the certificate of a bar is in units of its own.
        extra, D = place.certificate(q)
        step = -np.linalg.lstsq(
            np.concatenate([J[known] / 0.04, D]), np.concatenate([now.ravel()[known] / 0.04, extra]), rcond=None
        )[0]
        q = q + step
        before, now = now, miss(q)
        if float(np.nanmax(np.abs(now - before))) < SMALL_PX:
            break
    seen = np.isfinite(now).all(axis=1)
    return Residuals(recording.name, used.left_px[seen], now[seen])


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
