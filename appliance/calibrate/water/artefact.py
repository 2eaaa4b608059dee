"""Pose of an artefact in a water calibration: its first estimate, its parameters, and its residuals.

    triangulate, fit_plane, fit_sphere    the first estimate, from the correspondences of a recording
    PlanePose, BarPose                    parameters of a plane or a ball bar: where a ray intersects it, and the
                                          observations that its certificate adds
    first_pose                            the first estimate as such parameters, without rays at grazing incidence
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
    """Return the points (n, 3) of correspondences: left camera frame, mm, half way between both rays."""
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
    """Return the unit normal n towards +z and the offset e of the best-fit plane n·X = e of points (n, 3)."""
    middle = points_mm.mean(axis=0)
    _, _, axes = np.linalg.svd(points_mm - middle, full_matrices=False)
    normal = axes[2] if axes[2][2] > 0.0 else -axes[2]
    return normal, float(normal @ middle)


def fit_sphere(points_mm: Array, radius_mm: float | None = None) -> tuple[Array, float]:
    """Return centre and radius of the best-fit sphere of points (n, 3); the radius is fixed if given."""
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
        offset = local - centre
        distance = np.linalg.norm(offset, axis=1)
        jacobian = -offset / distance[:, None]
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
    residual_px: Array
    """(n, 2), right pixel as computed minus as observed."""

    @property
    def rms_px(self) -> float:
        """RMS residual per coordinate."""
        return float(np.sqrt(np.mean(self.residual_px**2)))


def residuals_of(recording: Recording, rig: StereoRig, points: int = 1500) -> Residuals:
    """Return the residuals that ``rig`` leaves of a recording.

    Raises RecordingError when the points do not look like the artefact.
    """
    pose, used = first_pose(thinned(recording, points), rig)
    index = used.water.index
    origin, direction = rig.left.rays(used.left_px, index)

    def residual(q: Array) -> Array:
        return rig.right.project(pose.intersect(origin, direction, used.sphere, q), index) - used.right_px

    q = np.zeros(len(pose.steps))
    current = residual(q)
    for _ in range(STEPS_AT_MOST):
        # Only the artefact's pose is adjusted; the rig stays as it is. Gauss-Newton without damping: the start is
        # within tenths of a millimetre.
        J = np.stack([(residual(q + e) - current).ravel() / e.max() for e in np.diag(pose.steps)], -1)
        is_finite = np.isfinite(J).all(axis=1) & np.isfinite(current.ravel())
        # Weighted by the noise of a correspondence, 0.04 px; the certificate's residuals have their own weight.
        certificate, D = pose.certificate(q)
        step = -np.linalg.lstsq(
            np.concatenate([J[is_finite] / 0.04, D]),
            np.concatenate([current.ravel()[is_finite] / 0.04, certificate]),
            rcond=None,
        )[0]
        q = q + step
        previous, current = current, residual(q)
        if float(np.nanmax(np.abs(current - previous))) < SMALL_PX:
            break
    is_visible = np.isfinite(current).all(axis=1)
    return Residuals(recording.name, used.left_px[is_visible], current[is_visible])


STEEPEST_COSINE = 0.4
"""Least cosine between ray and surface normal of a sphere; more grazing rays mainly show errors of the correspondence.
"""


@dataclass(frozen=True, slots=True)
class PlanePose:
    """Pose of the plane n·X = e.

    Parameters: two tilts of ``normal`` along ``axes`` (rad), and the change of the offset (mm).
    """

    normal: Array
    axes: Array
    offset_mm: float

    steps = np.array([1e-5, 1e-5, 1e-3])

    def intersect(self, origin: Array, direction: Array, sphere: NDArray[np.intp], x: Array) -> Array:
        """Return the points (n, 3) where rays intersect the plane; ``sphere`` is not used."""
        # A plane has three degrees of freedom; a third number for the normal would only be its length.
        n = self.normal + x[0] * self.axes[0] + x[1] * self.axes[1]
        n = n / np.linalg.norm(n)
        s = (self.offset_mm + x[2] - origin @ n) / (direction @ n)
        return np.asarray(origin + s[:, None] * direction)

    def certificate(self, x: Array) -> tuple[Array, Array]:
        """Return empty residuals (0,) and Jacobian (0, 3), because a plane has no certified length."""
        return np.empty(0), np.empty((0, 3))


@dataclass(frozen=True, slots=True)
class BarPose:
    """Pose of two spheres. Parameters: changes of both centres (6, mm) and of both radii (2, mm)."""

    centres_mm: Array
    radius_mm: float
    radius_sd_mm: float
    length_mm: float
    length_sd_mm: float

    steps = np.full(8, 1e-3)

    def intersect(self, origin: Array, direction: Array, sphere: NDArray[np.intp], x: Array) -> Array:
        """Return the points (n, 3) where rays first intersect their sphere; else their nearest point to it."""
        centre = (self.centres_mm + x[:6].reshape(2, 3))[sphere]
        radius = (self.radius_mm + x[6:8])[sphere]
        # |o + s d − c|² = r² is s² + 2 b s + |w|² − r² = 0; the nearer root is s = −b − √(b² − |w|² + r²). A negative
        # discriminant is set to zero, so that a ray beside the sphere still pulls it.
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


ArtefactPose = PlanePose | BarPose


def first_pose(recording: Recording, rig: StereoRig) -> tuple[ArtefactPose, Recording]:
    """Estimate the artefact's pose with ``rig``; return it and the recording without points of grazing incidence.

    Raises RecordingError when the points do not look like the artefact.
    """
    water_index = recording.water.index
    points = triangulate(rig, recording.left_px, recording.right_px, water_index)
    if recording.kind is ArtefactKind.PLANE:
        normal, offset = fit_plane(points)
        across = np.cross([0.0, 1.0, 0.0], normal)
        across /= np.linalg.norm(across)
        return PlanePose(normal, np.stack([across, np.cross(normal, across)]), offset), recording
    if recording.radius_mm is None or recording.length_mm is None:
        raise RecordingError(
            f"recording {recording.name}: the ball bar has no length or no radius; give those of its certificate"
        )
    centres = np.stack([fit_sphere(points[recording.sphere == k], recording.radius_mm)[0] for k in (0, 1)])
    length = float(np.linalg.norm(centres[1] - centres[0]))
    # With nominal ports the length is wrong by a few per cent at most; with ten, these are not the bar's balls.
    if abs(length / recording.length_mm - 1.0) > 0.1:
        raise RecordingError(
            f"recording {recording.name}: the balls are {length:.1f} mm apart, the certificate says "
            f"{recording.length_mm:g} mm; check the certified length, and which points belong to which ball"
        )
    outward = points - centres[recording.sphere]
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    is_steep = np.ones(len(points), bool)
    for camera in (rig.left, rig.right):
        towards_camera = np.asarray(camera.translation_mm) - points
        towards_camera /= np.linalg.norm(towards_camera, axis=1, keepdims=True)
        is_steep &= np.sum(outward * towards_camera, -1) > STEEPEST_COSINE
    bar = BarPose(centres, recording.radius_mm, recording.radius_sd_mm, recording.length_mm, recording.length_sd_mm)
    return bar, recording.select(is_steep)
