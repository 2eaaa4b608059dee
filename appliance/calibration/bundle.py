"""Owns the bundle adjustment in water: ports, and if wanted lenses, pose and image corrections, from few recordings.

Residual: the ray of the exact left pixel meets the artefact, the point is projected into the right camera, and there
it is compared with the matched right pixel, in both directions (the parallax across the baseline is what shows a
tilted port). Artefacts' places are unknowns; everything that the recordings cannot tell stays at its prior.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from appliance.calibration import parameters
from appliance.calibration.artefact import Place, first_place
from appliance.calibration.file import Calibration
from appliance.calibration.judgement import Estimate, judged, warnings_about
from appliance.calibration.recordings import ArtefactKind, Recording, RecordingError, thinned
from appliance.optics.correction import INTERVALS, ImageCorrection, basis_matrix, node_count
from appliance.optics.model import HousedCamera, StereoRig

Array = NDArray[np.float64]

PIXEL_STEP = 1e-3
BLOCK = 1024


class Rung(Enum):
    """How much the adjustment may change."""

    PORTS = "ports"
    """Per camera the port's tilt and distance; the calibration in air is believed."""
    ALL = "all"
    """Also both lenses and the stereo pose, held by the covariance of the calibration in air."""
    SPLINE = "spline"
    """Also a smooth image correction per camera."""


@dataclass(frozen=True, slots=True)
class BundleSettings:
    """Noise and priors (standard deviations), and when to stop."""

    noise_px: float = 0.04
    """Of a matched right pixel, per coordinate."""
    tilt_deg: float = 0.7
    distance_mm: float = 3.0
    mount_deg: float = 0.01
    """What the stereo pose may have changed between the calibration in air and the water."""
    mount_mm: float = 0.02
    refocus: float = 1e-4
    """Relative change of a principal distance between air and water."""
    spline_px: float = 0.15
    spline_bend_px: float = 0.05
    """Of second differences between neighbouring spline nodes."""
    points_per_recording: int = 1500
    far_residual: float = 4.0
    """Residuals beyond this many standard deviations lose weight in proportion (Huber)."""
    steps_at_most: int = 25
    small_step: float = 0.03
    """Converged when a step is shorter than this in standard deviations, all parameters together."""


@dataclass(frozen=True, slots=True)
class RecordingResidual:
    """What is left of one recording."""

    name: str
    points: int
    rms_px: float
    """Per coordinate."""


@dataclass(frozen=True, slots=True, eq=False)
class BundleResult:
    """A calibration, and what one should know before trusting it."""

    calibration: Calibration
    residuals: tuple[RecordingResidual, ...]
    systematic_px: float
    """RMS of what remains after averaging the noise away over patches of the image."""
    estimates: tuple[Estimate, ...]
    warnings: tuple[str, ...]
    steps: int

    @property
    def unobserved(self) -> tuple[str, ...]:
        """Names of the parameters that stayed at their prior because the recordings say nothing about them."""
        return tuple(estimate.name for estimate in self.estimates if estimate.at_prior)


def adjust(
    recordings: Sequence[Recording],
    start: Calibration,
    rung: Rung,
    air_covariance: Array | None = None,
    settings: BundleSettings | None = None,
) -> BundleResult:
    """Adjust ``start`` (air values with the design's ports) to recordings in water.

    ``air_covariance`` (22, 22) as ``AirCalibration`` gives it; needed by the rungs ALL and SPLINE. A few thousand
    points take seconds. Raises RecordingError for recordings that cannot be used or do not suffice, ValueError for a
    missing covariance.
    """
    chosen = settings or BundleSettings()
    if not any(r.kind is ArtefactKind.BALL_BAR for r in recordings):
        raise RecordingError("no recording of a ball bar; planes alone leave every length unknown; record a ball bar")
    problem = _Problem(recordings, start.rig, rung, air_covariance, chosen)
    x = np.zeros(problem.size)
    steps = 0
    hessian, gradient, cost, residuals = problem.linearise(x)
    for steps in range(1, chosen.steps_at_most + 1):  # noqa: B007 -- reported
        step = -np.linalg.solve(hessian, gradient)
        still_to_go = math.sqrt(max(float(-gradient @ step), 0.0))
        size = 1.0
        while True:
            tried = problem.linearise(x + size * step)
            if tried[2] <= cost * (1.0 + 1e-9) or size < 1e-3:
                break
            size *= 0.5
        x = x + size * step
        hessian, gradient, cost, residuals = tried
        if still_to_go < chosen.small_step:
            break
    else:
        raise RecordingError(
            f"the adjustment did not converge in {chosen.steps_at_most} steps; check the certificates, the water and "
            f"which points belong to which sphere"
        )
    covariance = np.linalg.inv(hessian)
    rig = problem.rig(x)
    counts = problem.active
    estimates = judged(
        [parameters.NAMES[k] for k in counts],
        x[: len(counts)],
        problem.prior_sd,
        np.sqrt(np.diag(covariance))[: len(counts)],
    )
    per_recording = tuple(
        RecordingResidual(r.name, len(r.left_px), float(np.sqrt(np.mean(e**2))))
        for r, e in zip(problem.recordings, residuals, strict=True)
    )
    pooled = np.concatenate(residuals)
    rms = float(np.sqrt(np.mean(pooled**2)))
    left = np.concatenate([r.left_px for r in problem.recordings])
    systematic, warnings = warnings_about(
        left, pooled, chosen.noise_px, start.rig.left, estimates, problem.certificates(x), rung is not Rung.SPLINE
    )
    calibration = replace(
        start,
        method=f"bundle, {rung.value}",
        made_from=(*start.made_from, *(f"recording {r.name}" for r in recordings)),
        water=recordings[0].water,
        rig=rig,
        residual_px=rms,
    )
    return BundleResult(calibration, per_recording, systematic, estimates, warnings, steps)


class _Problem:
    """The normal equations of one adjustment. Unknowns: the active rig parameters, spline nodes, artefacts."""

    def __init__(
        self,
        recordings: Sequence[Recording],
        rig: StereoRig,
        rung: Rung,
        air_covariance: Array | None,
        settings: BundleSettings,
    ) -> None:
        self._start = rig
        self._settings = settings
        self.active = list(range(parameters.COUNT if rung is not Rung.PORTS else parameters.PORTS.stop))
        count = len(self.active)
        tilt = math.radians(settings.tilt_deg)
        information = np.zeros((count, count))
        information[:6, :6] = np.diag(np.array([tilt, tilt, settings.distance_mm] * 2) ** -2.0)
        if rung is not Rung.PORTS:
            if air_covariance is None or air_covariance.shape != (22, 22):
                raise ValueError(
                    "the adjustment of all parameters needs the (22, 22) covariance of the air calibration"
                )
            widened = air_covariance.copy()
            widened[16:19, 16:19] += np.eye(3) * math.radians(settings.mount_deg) ** 2
            widened[19:22, 19:22] += np.eye(3) * settings.mount_mm**2
            for k, camera in ((0, rig.left), (8, rig.right)):
                widened[k, k] += (settings.refocus * camera.lens.f_px[0]) ** 2
            information[6:, 6:] = np.linalg.inv(widened)
        self.prior_sd = np.sqrt(np.diag(np.linalg.inv(information)))
        self._splines = rung is Rung.SPLINE
        nodes = 2 * node_count(INTERVALS) if self._splines else 0
        self._left_nodes = slice(count, count + nodes)
        self._right_nodes = slice(count + nodes, count + 2 * nodes)
        placed = [first_place(thinned(r, settings.points_per_recording), rig) for r in recordings]
        self.recordings = [recording for _, recording in placed]
        self._places: list[Place] = [place for place, _ in placed]
        at = count + 2 * nodes
        self._slices = []
        for place in self._places:
            self._slices.append(slice(at, at + len(place.steps)))
            at += len(place.steps)
        self.size = at
        self._prior = np.zeros((at, at))
        self._prior[:count, :count] = information
        if self._splines:
            smooth = _smoothness(settings)
            self._prior[self._left_nodes, self._left_nodes] = smooth
            self._prior[self._right_nodes, self._right_nodes] = smooth

    def rig(self, x: Array) -> StereoRig:
        """The rig at ``x``, with its corrections."""
        rig = self._bare(x)
        if not self._splines:
            return rig
        return StereoRig(
            replace(rig.left, correction=_correction(rig.left, x[self._left_nodes])),
            replace(rig.right, correction=_correction(rig.right, x[self._right_nodes])),
        )

    def certificates(self, x: Array) -> list[tuple[str, float]]:
        """Each bar's name and how many standard deviations its length is off its certificate."""
        found = []
        for recording, place, at in zip(self.recordings, self._places, self._slices, strict=True):
            residual, _ = place.certificate(x[at])
            if len(residual):
                found.append((recording.name, float(residual[0])))
        return found

    def linearise(self, x: Array) -> tuple[Array, Array, float, list[Array]]:
        """Hessian, gradient and cost of the robust sum of squares, and the residuals (n, 2) in px per recording."""
        noise = self._settings.noise_px
        hessian, gradient = self._prior.copy(), self._prior @ x
        cost = float(x @ gradient)
        residuals = []
        steps = parameters.STEPS[self.active]
        rig = self._bare(x)
        changed = []
        for k, step in enumerate(steps):
            y = x.copy()
            y[k] += step
            changed.append(self._bare(y))
        for recording, place, at in zip(self.recordings, self._places, self._slices, strict=True):
            index = recording.water.index
            left, right = recording.left_px, recording.right_px
            if self._splines:
                left_basis, right_basis = _basis_matrix(rig.left, left), _basis_matrix(rig.right, right)
                left = left - _surface(left_basis, x[self._left_nodes])
                right = right - _surface(right_basis, x[self._right_nodes])

            def predicted(
                rig: StereoRig,
                uv: Array = left,
                q: Array = x[at],
                place: Place = place,
                recording: Recording = recording,
                index: float = index,
            ) -> Array:
                origin, direction = rig.left.rays(uv, index)
                return _project(rig.right, place.meet(origin, direction, recording.sphere, q), index)

            now = predicted(rig)
            residual = now - right
            rows = np.zeros((len(left), 2, len(steps)))
            for k, (other, step) in enumerate(zip(changed, steps, strict=True)):
                rows[..., k] = (predicted(other) - now) / step
            own = np.zeros((len(left), 2, len(place.steps)))
            for k, step in enumerate(place.steps):
                q = x[at].copy()
                q[k] += step
                own[..., k] = (predicted(rig, q=q) - now) / step
            columns = [np.arange(len(steps)), np.arange(at.start, at.stop)]
            parts = [rows, own]
            if self._splines:
                by_u = (predicted(rig, uv=left + np.array([PIXEL_STEP, 0.0])) - now) / PIXEL_STEP
                by_v = (predicted(rig, uv=left + np.array([0.0, PIXEL_STEP])) - now) / PIXEL_STEP
                # The left correction is subtracted before the ray, the right one from the matched pixel.
                parts.append(
                    -np.concatenate([by_u[..., None] * left_basis[:, None], by_v[..., None] * left_basis[:, None]], -1)
                )
                zero = np.zeros_like(right_basis)
                parts.append(
                    np.stack([np.concatenate([right_basis, zero], -1), np.concatenate([zero, right_basis], -1)], 1)
                )
                columns += [np.arange(s.start, s.stop) for s in (self._left_nodes, self._right_nodes)]
            J = np.concatenate(parts, -1).reshape(2 * len(left), -1) / noise
            far = np.linalg.norm(residual, axis=1) / noise / self._settings.far_residual
            weight = np.repeat(1.0 / np.maximum(far, 1.0), 2)
            e = residual.ravel() / noise
            column = np.concatenate(columns)
            hessian[np.ix_(column, column)] += J.T @ (J * weight[:, None])
            gradient[column] += J.T @ (weight * e)
            k2 = self._settings.far_residual**2
            cost += float(np.sum(np.where(far <= 1.0, far**2, 2.0 * far - 1.0)) * k2)
            extra, D = place.certificate(x[at])
            hessian[at, at] += D.T @ D
            gradient[at] += D.T @ extra
            cost += float(extra @ extra)
            residuals.append(residual)
        return hessian, gradient, cost, residuals

    def _bare(self, x: Array) -> StereoRig:
        full = np.zeros(parameters.COUNT)
        full[self.active] = x[: len(self.active)]
        return parameters.rig_with(self._start, full)


def _project(camera: HousedCamera, points_mm: Array, water_index: float) -> Array:
    """Pixels of points, before any image correction."""
    local = (points_mm - np.asarray(camera.translation_mm)) @ np.asarray(camera.rotation)
    return camera.ideal_pixels(local, water_index)


def _basis_matrix(camera: HousedCamera, uv_px: Array) -> Array:
    return basis_matrix(uv_px, (camera.width_px, camera.height_px), INTERVALS)


def _surface(matrix: Array, nodes: Array) -> Array:
    """Shifts (n, 2) px; ``nodes`` holds all of u, then all of v."""
    return np.asarray(matrix @ nodes.reshape(2, -1).T)


def _correction(camera: HousedCamera, nodes: Array) -> ImageCorrection:
    coefficients = tuple(float(c) for c in nodes.reshape(2, -1).T.ravel())
    return ImageCorrection(camera.width_px, camera.height_px, INTERVALS, coefficients)


def _smoothness(settings: BundleSettings) -> Array:
    """Information matrix of one camera's nodes: small values, small second differences along rows and columns."""
    columns, rows = INTERVALS[0] + 3, INTERVALS[1] + 3
    across, down = np.diff(np.eye(columns), 2, axis=0), np.diff(np.eye(rows), 2, axis=0)
    bends = np.concatenate([np.kron(np.eye(rows), across), np.kron(down, np.eye(columns))])
    one = np.eye(columns * rows) / settings.spline_px**2 + bends.T @ bends / settings.spline_bend_px**2
    return np.asarray(np.kron(np.eye(2), one))
