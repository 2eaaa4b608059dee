"""Bundle adjustment in water: ports, and optionally lenses, extrinsics and image corrections.

    adjust, solve_problem              the adjustment and its result
    Problem                            parameters, priors and normal equations of one adjustment
    RecordingJacobian, NodeJacobian    residuals and Jacobian of one recording: a few parameters change every point, but
                                       only sixteen of the many nodes of a surface change one

Residual: the ray of the exact left pixel intersects the artefact, the point is projected into the right camera, and
there it is compared with the matched right pixel, in both directions (the parallax across the baseline shows a tilted
port). The poses of the artefacts are parameters; every parameter that the recordings do not determine stays at its
prior.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.determined import UndeterminedError, solve_symmetric
from appliance.calibrate.field import FieldPrior
from appliance.calibrate.recordings import ArtefactKind, NotConverged, Recording, RecordingError, thinned
from appliance.calibrate.water.artefact import ArtefactPose, first_pose
from appliance.calibrate.water.expected import (
    AdjustmentUncertainty,
    Columns,
    expected_depth_error_mm2,
    expected_errors,
    warnings_about_expected,
)
from appliance.calibrate.water.judgement import estimates_of, systematic_px, warnings_about
from appliance.calibrate.water.method import Method, WaterResult
from appliance.measure import RIG_PARAMETERS, SIDES, Calibration, HousedCamera, SplineGrid, StereoRig, Water

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class NodeBasis:
    """Nodes with influence on each of n points, and their weights."""

    nodes: NDArray[np.intp]
    """(n, 16)."""
    weights: Array
    """(n, 16)."""
    count: int
    """Number of nodes of one component of the surface."""

    @classmethod
    def at(cls, uv_px: Array, grid: SplineGrid) -> NodeBasis:
        """Return the basis at pixels (n, 2)."""
        return cls(*grid.entries(uv_px), grid.count)

    def surface(self, nodes: Array) -> Array:
        """Return values (n, 2); ``nodes`` has all of the first component, then all of the second."""
        return np.stack([np.sum(self.weights * part[self.nodes], axis=1) for part in np.split(nodes, 2)], -1)


@dataclass(frozen=True, slots=True, eq=False)
class NodeJacobian:
    """Jacobian by the nodes of one surface: derivatives by its components, times its basis."""

    columns: slice
    """Columns among all parameters: the nodes of the first component, then those of the second."""
    basis: NodeBasis
    by_component: Sequence[Array]
    """Two of (n, 2) or (2,): derivatives of the residuals by the first and the second component of the surface."""

    def matrix(self) -> Any:
        """Return the sparse Jacobian (2 n, 2·nodes), rows of all first coordinates, then of all second."""
        import scipy.sparse  # half a second that a start of the service does not need

        n = len(self.basis.nodes)
        two = [np.broadcast_to(d, (n, 2)) for d in self.by_component]
        data = np.concatenate([np.concatenate([self.basis.weights * d[:, [k]] for d in two], axis=1) for k in (0, 1)])
        indices = np.concatenate([self.basis.nodes, self.basis.nodes + self.basis.count], axis=1)
        indices = np.concatenate([indices, indices])
        starts = np.arange(2 * n + 1) * indices.shape[1]
        return scipy.sparse.csr_matrix((data.ravel(), indices.ravel(), starts), (2 * n, 2 * self.basis.count))


@dataclass(frozen=True, slots=True, eq=False)
class RecordingJacobian:
    """Residuals of n points, and their Jacobian by all parameters."""

    residual: Array
    """(n, 2), px."""
    dense: Array
    """(n, 2, k): by the parameters that change every point."""
    columns: NDArray[np.intp]
    """(k,): columns of these among all parameters."""
    nodes: Sequence[NodeJacobian]

    def add(self, hessian: Array, gradient: Array, weight: Array) -> None:
        """Add Jᵀ W J to ``hessian`` and Jᵀ W r to ``gradient``, in place.

        ``weight`` (2 n,) is of all first coordinates, then of all second.
        """
        D = np.concatenate([self.dense[:, 0], self.dense[:, 1]])
        r = weight * np.concatenate([self.residual[:, 0], self.residual[:, 1]])
        WD = weight[:, None] * D
        hessian[np.ix_(self.columns, self.columns)] += D.T @ WD
        gradient[self.columns] += D.T @ r
        if not self.nodes:
            return
        import scipy.sparse  # as above

        N = scipy.sparse.hstack([part.matrix() for part in self.nodes], format="csr")
        columns = np.concatenate([np.arange(part.columns.start, part.columns.stop) for part in self.nodes])
        cross = N.T @ WD
        hessian[np.ix_(columns, self.columns)] += cross
        hessian[np.ix_(self.columns, columns)] += cross.T
        hessian[np.ix_(columns, columns)] += (N.T @ N.multiply(weight[:, None])).toarray()
        gradient[columns] += N.T @ r


PIXEL_STEP = 1e-3
INDEX_STEP = 1e-5
REFITS, REFIT_ROUNDS, REFIT_STEP = 2, 3, 3.0
"""Number of estimates of the ports' field variances, rounds of each, and distance from the solution (standard
deviations) within which one is made."""


@dataclass(frozen=True, slots=True)
class BundleSettings:
    """Noise, priors (standard deviations), and limits of convergence."""

    noise_px: float = 0.04
    """Standard deviation of a matched right pixel, per coordinate."""
    tilt_deg: float = 0.7
    distance_mm: float = 3.0
    mount_deg: float = 0.01
    """Standard deviation of the change of the extrinsics between air and water."""
    mount_mm: float = 0.02
    refocus: float = 1e-4
    """Relative change of a principal distance between air and water."""
    spline_px: float = 0.15
    """Standard deviation of a spline node where the start has no fields from air; 0 for no image correction."""
    spline_bend_px: float = 0.05
    """Standard deviation of second differences between neighbouring spline nodes."""
    points_per_recording: int = 1500
    far_residual: float = 4.0
    """Number of standard deviations beyond which residuals lose weight in proportion (Huber)."""
    led_nm: float = 5.8
    """Standard deviation of the LED's wavelength about that of the stated water: ± 10 nm by its data sheet, uniform."""
    steps_at_most: int = 25
    small_step: float = 0.03
    """Length of a step, in standard deviations of all parameters together, below which the adjustment has converged."""


def adjust(
    recordings: Sequence[Recording], start: Calibration, method: Method, settings: BundleSettings | None = None
) -> WaterResult:
    """Adjust ``start`` (air values with nominal ports) to recordings in water; ``method`` is PORTS or SPLINE.

    A few thousand points take seconds. Raises RecordingError for recordings that cannot be used or do not suffice, and
    for a start without the covariance from air that SPLINE needs.
    """
    if not any(r.kind is ArtefactKind.BALL_BAR for r in recordings):
        raise RecordingError("no recording of a ball bar; planes alone do not determine lengths; record a ball bar")
    if start.air_covariance is None and method is not Method.PORTS:
        raise RecordingError(
            f"the start ({start.method}) has no covariance from air, which {method.value} needs; start from "
            f"the air calibration, or use {Method.PORTS.value}"
        )
    return solve_problem(Problem(recordings, start, method, settings or BundleSettings()))


def solve_problem(problem: Problem) -> WaterResult:
    """Solve the normal equations of ``problem``.

    Raises RecordingError if they leave a parameter free, or do not converge.
    """
    try:
        return _solve(problem)
    except UndeterminedError as error:
        raise RecordingError(
            f"the recordings do not determine {', '.join(error.names)}; record planes that fill the image, "
            "and ball bars in many directions"
        ) from error


def _solve(problem: Problem) -> WaterResult:
    start, chosen, recordings = problem.start, problem.settings, problem.recordings
    x = problem.mean.copy()
    hessian, gradient, cost, residuals = problem.linearise(x)
    costs = [cost]
    refits = REFITS if problem.windows is not None else 0
    for _ in range(chosen.steps_at_most):
        step = -solve_symmetric(hessian, gradient, problem.names)
        # Newton decrement: the length of the step in standard deviations of the posterior, over all parameters
        # together.
        decrement = math.sqrt(max(float(-gradient @ step), 0.0))
        size = 1.0
        while True:
            candidate = problem.linearise(x + size * step)
            if candidate[2] <= cost * (1.0 + 1e-9) or size < 1e-3:
                break
            size *= 0.5
        x = x + size * step
        hessian, gradient, cost, residuals = candidate
        costs.append(cost)
        if refits and decrement < REFIT_STEP:
            # Residuals near the solution determine the variances of the fields. With the new prior the same parameters
            # have another cost: earlier costs are shifted by the difference, so that they stay comparable.
            refits -= 1
            problem.refit(hessian, gradient, x)
            before = cost
            hessian, gradient, cost, residuals = problem.linearise(x)
            costs = [earlier + cost - before for earlier in costs]
        elif decrement < chosen.small_step:
            break
    else:
        raise NotConverged(
            f"the adjustment did not converge in {chosen.steps_at_most} steps; check the certificates, the "
            "water, and which points belong to which ball"
        )
    covariance = solve_symmetric(hessian, np.eye(problem.size), problem.names)
    rig = problem.rig(x)
    active = problem.active
    estimates = estimates_of(
        [RIG_PARAMETERS.names[k] for k in active],
        x[: len(active)] - problem.mean[: len(active)],
        problem.prior_sd,
        np.sqrt(np.diag(covariance))[: len(active)],
    )
    pooled = np.concatenate(residuals)
    rms = float(np.sqrt(np.mean(pooled**2)))
    left_px = np.concatenate([r.left_px for r in recordings])
    mean_systematic_px, warnings = warnings_about(
        left_px,
        pooled,
        chosen.noise_px,
        start.rig.left,
        estimates,
        problem.certificates(x),
        not problem.has_nodes,
    )
    # Systematic residuals of single recordings (a bent plane, a moved bar) cancel in the mean over all of them.
    recording_numbers = np.repeat(np.arange(len(residuals)), [len(e) for e in residuals])
    systematic_rest_px = max(mean_systematic_px, systematic_px(left_px, pooled, start.rig.left, recording_numbers))
    # Systematic residuals finer than a patch are not in its mean, but in the variance beyond the noise.
    systematic_rest_px = max(systematic_rest_px, math.sqrt(max(rms**2 - chosen.noise_px**2, 0.0)))
    bar = next(r for r in recordings if r.kind is ArtefactKind.BALL_BAR)
    noise_ratio = max(1.0, rms / chosen.noise_px)
    # Residuals show the difference of both cameras' fields. Where the boards in air were adjusted without fields, their
    # effect on lenses and extrinsics is hidden, and about as large again.
    is_hidden = problem.has_nodes and start.air_field is None
    # The refractive index is not adjusted, because recordings do not separate it from the ports. The effect of another
    # wavelength of the LED on the adjustment is propagated to the lengths separately.
    _, changed_gradient, _, _ = problem.linearise(x, INDEX_STEP)
    by_index = -covariance @ (changed_gradient - gradient) / INDEX_STEP
    uncertainty = AdjustmentUncertainty(
        covariance * noise_ratio**2,
        by_index,
        _index_sd(bar.water, chosen.led_nm),
        2.0 * systematic_rest_px if is_hidden else systematic_rest_px,
    )
    expected = expected_errors(rig, bar, uncertainty, problem.columns)
    warnings += warnings_about_expected(expected, recordings, systematic_rest_px, not is_hidden)
    depth_error_mm2 = expected_depth_error_mm2(rig, bar.water.index, uncertainty, problem.columns)
    # Rounding makes a product of matrices slightly asymmetric.
    depth_error_mm2 = 0.5 * (depth_error_mm2 + depth_error_mm2.T) + 1e-7 * np.eye(len(depth_error_mm2))
    calibration = replace(
        start,
        method=f"bundle, {problem.method.value}",
        made_from=(*start.made_from, *(f"recording {r.name}" for r in recordings)),
        water=recordings[0].water,
        rig=rig,
        residual_px=rms,
        air_covariance=None,
        air_field=None,
        depth_error_mm2=tuple(tuple(row) for row in depth_error_mm2.tolist()),
    )
    bars = sum(r.kind is ArtefactKind.BALL_BAR for r in recordings)
    planes = len(recordings) - bars
    if bars < 2 or planes < 1:
        warning = (
            f"{bars} bars and {planes} planes: scale needs bars in two directions, tilts need planes; "
            "record two bars, turned and leaning, and two planes, near and far"
        )
        warnings += (warning,)
    return WaterResult(
        problem.method,
        calibration,
        warnings,
        systematic_px=mean_systematic_px,
        estimates=estimates,
        costs=tuple(costs),
        expected=expected,
    )


class Problem:
    """Normal equations of one adjustment. Parameters: active rig parameters, spline nodes, poses of artefacts."""

    def __init__(
        self, recordings: Sequence[Recording], start: Calibration, method: Method, settings: BundleSettings
    ) -> None:
        self.start = start
        self.method = method
        self.settings = settings
        rig, air_field = start.rig, start.air_field
        self.active = list(range(RIG_PARAMETERS.ports.stop if method is Method.PORTS else RIG_PARAMETERS.count))
        count = len(self.active)
        tilt = math.radians(settings.tilt_deg)
        # Priors as an information matrix, that is the inverse of a covariance. The ports are nominal and independent.
        # For lenses and extrinsics it is the full covariance from air, whose parameters are strongly correlated
        # (principal distance with k1, yaw with the principal point).
        information = np.zeros((count, count))
        information[:6, :6] = np.diag(np.array([tilt, tilt, settings.distance_mm] * 2) ** -2.0)
        if method is not Method.PORTS:
            information[6:, 6:] = np.linalg.inv(_widen(np.array(start.air_covariance), rig, settings))
        self.prior_sd = np.sqrt(np.diag(np.linalg.inv(information)))
        self.has_nodes = method is Method.SPLINE and settings.spline_px > 0.0
        size_px = rig.left.width_px, rig.left.height_px
        self._grid = SplineGrid(size_px) if air_field is None else SplineGrid(size_px, air_field.intervals)
        nodes = 2 * self._grid.count if self.has_nodes else 0
        # Order of the parameters x: rig, nodes of the left and right image correction, then each artefact's pose.
        self._left_nodes, self._right_nodes = slice(count, count + nodes), slice(count + nodes, count + 2 * nodes)
        first_poses = [first_pose(thinned(r, settings.points_per_recording), rig) for r in recordings]
        self.recordings = [recording for _, recording in first_poses]
        self._poses: list[ArtefactPose] = [pose for pose, _ in first_poses]
        stop = self._right_nodes.stop
        self._slices = []
        for pose in self._poses:
            self._slices.append(slice(stop, stop + len(pose.steps)))
            stop += len(pose.steps)
        self.size = stop
        self.prior = np.zeros((stop, stop))
        self.prior[:count, :count] = information
        self.mean = np.zeros(stop)
        self.windows: FieldPrior | None = None
        """Prior of rig and fields where the air calibration has fields; it estimates their variances."""
        if self.has_nodes and air_field is not None:
            covariance = np.zeros((self._right_nodes.stop,) * 2)
            covariance[:6, :6] = np.linalg.inv(information[:6, :6])
            covariance[6:, 6:] = _widen(air_field.covariance, rig, settings)
            mean = np.concatenate([np.zeros(6), air_field.mean])
            self.windows = FieldPrior(covariance, mean, self._grid)
            self.mean[: len(mean)] = mean
            self.prior[: len(mean), : len(mean)] = self.windows.information
            self.prior_sd = np.sqrt(np.diag(covariance)[:count])
        elif self.has_nodes:
            smooth = smoothness(self._grid.intervals, settings.spline_px, settings.spline_bend_px)
            self.prior[self._left_nodes, self._left_nodes] = smooth
            self.prior[self._right_nodes, self._right_nodes] = smooth

    def rig(self, x: Array) -> StereoRig:
        """Return the rig at ``x``, with its image corrections."""
        rig = self.bare(x)
        if not self.has_nodes:
            return rig
        return replace(
            rig,
            left=self._corrected(rig.left, x[self._left_nodes]),
            right=self._corrected(rig.right, x[self._right_nodes]),
        )

    @property
    def names(self) -> list[str]:
        """Names of all parameters, in order."""
        named = [RIG_PARAMETERS.names[k] for k in self.active]
        for side, part in zip(SIDES, (self._left_nodes, self._right_nodes), strict=True):
            named += [f"{side} image correction"] * (part.stop - part.start)
        for recording, part in zip(self.recordings, self._slices, strict=True):
            named += [f"the place of {recording.name}"] * (part.stop - part.start)
        return named

    @property
    def columns(self) -> Columns:
        """Columns of the rig's parameters."""
        return Columns(tuple(self.active), (self._left_nodes, self._right_nodes))

    def refit(self, hessian: Array, gradient: Array, x: Array) -> None:
        """Estimate the variances of the fields from the normal equations at ``x``, and update the nodes' prior."""
        if self.windows is None:
            return
        data_gradient = gradient - self.prior @ (x - self.mean)
        self.windows.refit(hessian - self.prior, data_gradient, x, REFIT_ROUNDS)
        m = len(self.windows.mean)
        self.prior[:m, :m] = self.windows.information

    def certificates(self, x: Array) -> list[tuple[str, float]]:
        """Return each bar's name and the error of its length in standard deviations of its certificate."""
        errors = []
        for recording, pose, part in zip(self.recordings, self._poses, self._slices, strict=True):
            residual, _ = pose.certificate(x[part])
            if len(residual):
                errors.append((recording.name, float(residual[0])))
        return errors

    def linearise(self, x: Array, index_change: float = 0.0) -> tuple[Array, Array, float, list[Array]]:
        """Return Hessian, gradient and cost of the robust sum of squares, and the residuals of each recording.

        Residuals (n, 2) are in px. ``index_change`` is added to the refractive index of the water.
        """
        noise = self.settings.noise_px
        # Gauss-Newton of E(x) = xᵀ P x + Σ ρ(|e| / σ) + Σ certificates²: the Hessian is P + Σ Jᵀ W J, without second
        # derivatives of e. The prior's mean is the start, or what the boards in air say.
        hessian, gradient = self.prior.copy(), self.prior @ (x - self.mean)
        cost = float((x - self.mean) @ gradient)
        residuals = []
        rig = self.bare(x)
        changed = []
        for k, step in enumerate(RIG_PARAMETERS.steps[self.active]):
            y = x.copy()
            y[k] += step
            changed.append((self.bare(y), step))
        for recording, pose, part in zip(self.recordings, self._poses, self._slices, strict=True):
            jacobian = self.slopes(x, rig, changed, recording, pose, part, index_change)
            residual = jacobian.residual
            distance = np.linalg.norm(residual, axis=1) / noise / self.settings.far_residual
            # Huber's weight, from the length of the residual so that both coordinates of one point have the same: 1
            # inside far_residual, 1/distance outside.
            weight = np.tile(1.0 / np.maximum(distance, 1.0) / noise**2, 2)
            jacobian.add(hessian, gradient, weight)
            k2 = self.settings.far_residual**2
            # ρ of Huber: r² inside, 2 r − 1 outside, in units of far_residual; continuous in value and slope at 1.
            cost += float(np.sum(np.where(distance <= 1.0, distance**2, 2.0 * distance - 1.0)) * k2)
            certificate, D = pose.certificate(x[part])
            hessian[part, part] += D.T @ D
            gradient[part] += D.T @ certificate
            cost += float(certificate @ certificate)
            residuals.append(residual)
        return hessian, gradient, cost, residuals

    def slopes(
        self,
        x: Array,
        rig: StereoRig,
        changed: Sequence[tuple[StereoRig, float]],
        recording: Recording,
        pose: ArtefactPose,
        part: slice,
        index_change: float,
    ) -> RecordingJacobian:
        """Return the residuals of one recording and their Jacobian by all parameters.

        ``changed`` has the rig with one step of each of the first parameters.
        """
        index = recording.water.index + index_change
        left, right = recording.left_px, recording.right_px
        if self.has_nodes:
            left_basis, right_basis = NodeBasis.at(left, self._grid), NodeBasis.at(right, self._grid)
            left = left - left_basis.surface(x[self._left_nodes])
            right = right - right_basis.surface(x[self._right_nodes])

        def predicted(rig: StereoRig, uv: Array = left, q: Array = x[part]) -> Array:
            # Left pixel → refracted ray → point on the artefact → refracted projection into the right camera. Both
            # coordinates count: the one across the epipolar curve shows a tilted port.
            return rig.right.project(pose.intersect(*rig.left.rays(uv, index), recording.sphere, q), index)

        pixels = predicted(rig)
        # Forward differences: refraction has no simple closed derivative, and the functions are smooth far below the
        # steps.
        blocks = [np.stack([(predicted(changed_rig) - pixels) / step for changed_rig, step in changed], -1)]
        blocks.append(np.stack([(predicted(rig, q=x[part] + e) - pixels) / e.max() for e in np.diag(pose.steps)], -1))
        columns = np.concatenate([np.arange(len(changed)), np.arange(part.start, part.stop)])
        nodes: list[NodeJacobian] = []
        if self.has_nodes:
            # The left correction is subtracted before the ray, the right one from the matched pixel.
            by_left = [(predicted(rig, uv=left - e) - pixels) / PIXEL_STEP for e in PIXEL_STEP * np.eye(2)]
            nodes.append(NodeJacobian(self._left_nodes, left_basis, by_left))
            nodes.append(NodeJacobian(self._right_nodes, right_basis, list(np.eye(2))))
        return RecordingJacobian(pixels - right, np.concatenate(blocks, -1), columns, nodes)

    def _corrected(self, camera: HousedCamera, nodes: Array) -> HousedCamera:
        return replace(camera, correction=self._grid.correction(nodes.reshape(2, -1).T))

    def bare(self, x: Array) -> StereoRig:
        """Return the rig at ``x``, without its image corrections."""
        return RIG_PARAMETERS.changed(self.start.rig, x[: len(self.active)], self.active)


def _index_sd(water: Water, led_nm: float) -> float:
    """Return the standard deviation of the refractive index for one of the wavelength of ``led_nm``."""
    redder, bluer = (replace(water, wavelength_nm=water.wavelength_nm + nm).index for nm in (1.0, -1.0))
    return abs(redder - bluer) / 2.0 * led_nm


def _widen(covariance: Array, rig: StereoRig, settings: BundleSettings) -> Array:
    """Return the covariance from air (22 parameters, or more that follow them) as it holds in water."""
    # Between air and water the mount may bend and the focus may creep. Both widen the prior, because the adjustment
    # would otherwise put these changes into the ports.
    widened = covariance.copy()
    widened[16:19, 16:19] += np.eye(3) * math.radians(settings.mount_deg) ** 2
    widened[19:22, 19:22] += np.eye(3) * settings.mount_mm**2
    for k, camera in ((0, rig.left), (8, rig.right)):
        widened[k, k] += (settings.refocus * camera.lens.f_px[0]) ** 2
    return widened


def smoothness(intervals: tuple[int, int], value_sd: float, bend_sd: float) -> Array:
    """Return the information matrix of one camera's nodes: small values and small second differences."""
    # A cubic B-spline over n intervals has n + 3 coefficients. The information is I / value_sd² + BᵀB / bend_sd² with B
    # the second differences: a thin-plate prior without a null space.
    columns, rows = intervals[0] + 3, intervals[1] + 3
    across, down = np.diff(np.eye(columns), 2, axis=0), np.diff(np.eye(rows), 2, axis=0)
    bends = np.concatenate([np.kron(np.eye(rows), across), np.kron(down, np.eye(columns))])
    component_information = np.eye(columns * rows) / value_sd**2 + bends.T @ bends / bend_sd**2
    return np.asarray(np.kron(np.eye(2), component_information))
