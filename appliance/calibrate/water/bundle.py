"""Owns the bundle adjustment in water: ports, and if wanted lenses, pose and image corrections, from few recordings.

Residual: the ray of the exact left pixel meets the artefact, the point is projected into the right camera, and there
it is compared with the matched right pixel, in both directions (the parallax across the baseline is what shows a
tilted port). Artefacts' places are unknowns; everything that the recordings cannot tell stays at its prior.

It also owns the slopes of one recording's residuals, and how they enter the normal equations: few unknowns touch every
point, and of the many nodes of a surface sixteen touch one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.determined import UndeterminedError, solved
from appliance.calibrate.field import FieldPrior
from appliance.calibrate.recordings import ArtefactKind, NotConverged, Recording, RecordingError, thinned
from appliance.calibrate.water.artefact import Place, first_place
from appliance.calibrate.water.expected import (
    Columns,
    Doubt,
    expected,
    expected_depth_error_mm2,
    warnings_about_expected,
)
from appliance.calibrate.water.judgement import judged, systematic_px, warnings_about
from appliance.calibrate.water.method import Method, WaterResult
from appliance.measure import RIG_PARAMETERS, SIDES, Calibration, HousedCamera, SplineGrid, StereoRig, Water

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class NodeBasis:
    """The nodes that touch each of n points, and how much."""

    nodes: NDArray[np.intp]
    """(n, 16)."""
    weights: Array
    """(n, 16)."""
    count: int
    """All nodes of one component of the surface."""

    @classmethod
    def at(cls, uv_px: Array, grid: SplineGrid) -> NodeBasis:
        """Return that of pixels (n, 2)."""
        return cls(*grid.entries(uv_px), grid.count)

    def surface(self, nodes: Array) -> Array:
        """Return values (n, 2); ``nodes`` holds all of the first component, then all of the second."""
        return np.stack([np.sum(self.weights * part[self.nodes], axis=1) for part in np.split(nodes, 2)], -1)


@dataclass(frozen=True, slots=True, eq=False)
class NodeSlopes:
    """Slopes by the nodes of one surface: those of the residuals by the surface's components, times its basis."""

    columns: slice
    """Places among all unknowns: the nodes of the first component, then those of the second."""
    basis: NodeBasis
    by_component: Sequence[Array]
    """Two of (n, 2) or (2,): the residuals' slopes by the surface's first and second component."""

    def matrix(self) -> Any:
        """Return the slopes (2 n, 2·nodes), a sparse matrix: all first coordinates of the residuals, then all second."""
        import scipy.sparse  # half a second that a start of the service does not need

        n = len(self.basis.nodes)
        two = [np.broadcast_to(d, (n, 2)) for d in self.by_component]
        data = np.concatenate([np.concatenate([self.basis.weights * d[:, [k]] for d in two], axis=1) for k in (0, 1)])
        indices = np.concatenate([self.basis.nodes, self.basis.nodes + self.basis.count], axis=1)
        indices = np.concatenate([indices, indices])
        starts = np.arange(2 * n + 1) * indices.shape[1]
        return scipy.sparse.csr_matrix((data.ravel(), indices.ravel(), starts), (2 * n, 2 * self.basis.count))


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """Residuals of n points, and their slopes by all unknowns."""

    residual: Array
    """(n, 2), px."""
    dense: Array
    """(n, 2, k): by the unknowns that touch every point."""
    columns: NDArray[np.intp]
    """(k,): which of all unknowns these are."""
    nodes: Sequence[NodeSlopes]

    def add(self, hessian: Array, gradient: Array, weight: Array) -> None:
        """Add Jᵀ W J to ``hessian`` and Jᵀ W r to ``gradient``, in place; ``weight`` (2 n,) is of all first
        coordinates, then of all second."""
        D = np.concatenate([self.dense[:, 0], self.dense[:, 1]])
        r = weight * np.concatenate([self.residual[:, 0], self.residual[:, 1]])
        WD = weight[:, None] * D
        hessian[np.ix_(self.columns, self.columns)] += D.T @ WD
        gradient[self.columns] += D.T @ r
        if not self.nodes:
            return
        import scipy.sparse  # as above

        N = scipy.sparse.hstack([one.matrix() for one in self.nodes], format="csr")
        columns = np.concatenate([np.arange(one.columns.start, one.columns.stop) for one in self.nodes])
        cross = N.T @ WD
        hessian[np.ix_(columns, self.columns)] += cross
        hessian[np.ix_(self.columns, columns)] += cross.T
        hessian[np.ix_(columns, columns)] += (N.T @ N.multiply(weight[:, None])).toarray()
        gradient[columns] += N.T @ r


PIXEL_STEP = 1e-3
INDEX_STEP = 1e-5
REFITS, REFIT_ROUNDS, REFIT_STEP = 2, 3, 3.0
"""Number of estimates of the windows' waviness, rounds of each, and distance from the solution within which one is made
(standard deviations)."""


@dataclass(frozen=True, slots=True)
class BundleSettings:
    """Noise and priors (standard deviations), and when to stop."""

    noise_px: float = 0.04
    """Standard deviation of a matched right pixel, per coordinate."""
    tilt_deg: float = 0.7
    distance_mm: float = 3.0
    mount_deg: float = 0.01
    """Standard deviation of the change of the stereo pose between the calibration in air and the water."""
    mount_mm: float = 0.02
    refocus: float = 1e-4
    """Relative change of a principal distance between air and water."""
    spline_px: float = 0.15
    """Standard deviation of a spline node where the start has no fields from air; 0: no image correction is adjusted.
    """
    spline_bend_px: float = 0.05
    """Standard deviation of second differences between neighbouring spline nodes."""
    points_per_recording: int = 1500
    far_residual: float = 4.0
    """Residuals beyond this many standard deviations lose weight in proportion (Huber)."""
    led_nm: float = 5.8
    """Standard deviation of the LED's wavelength about that of the water's index: ± 10 nm of its data sheet, evenly
    spread."""
    steps_at_most: int = 25
    small_step: float = 0.03
    """Converged when a step is shorter than this in standard deviations, all parameters together."""


def adjust(
    recordings: Sequence[Recording], start: Calibration, method: Method, settings: BundleSettings | None = None
) -> WaterResult:
    """Adjust ``start`` (air values with the design's ports) to recordings in water; ``method`` is PORTS or SPLINE.

    A few thousand points take seconds. Raises RecordingError for recordings that cannot be used or do not suffice, and
    for a start that lacks the covariance from air, which SPLINE needs.
    """
    if not any(r.kind is ArtefactKind.BALL_BAR for r in recordings):
        raise RecordingError("no recording of a ball bar; planes alone leave every length unknown; record a ball bar")
    if start.air_covariance is None and method is not Method.PORTS:
        raise RecordingError(
            f"the start ({start.method}) has no covariance from air, which {method.value} needs; start from the "
            f"calibration in air, or use {Method.PORTS.value}"
        )
    return adjusted(Problem(recordings, start, method, settings or BundleSettings()))


def adjusted(problem: Problem) -> WaterResult:
    """Return what solving the normal equations gives.

    Raises RecordingError if they leave something open, or do not converge.
    """
    try:
        return _adjusted(problem)
    except UndeterminedError as error:
        raise RecordingError(
            f"the recordings do not determine {', '.join(error.names)}; record planes that fill the image and bars "
            "whose balls are seen "
            "from many sides"
        ) from error


def _adjusted(problem: Problem) -> WaterResult:
    start, chosen, recordings = problem.start, problem.settings, problem.recordings
    x = problem.mean.copy()
    hessian, gradient, cost, residuals = problem.linearise(x)
    costs = [cost]
    refits = REFITS if problem.windows is not None else 0
    for _ in range(chosen.steps_at_most):
        step = -solved(hessian, gradient, problem.names)
        # Newton decrement: the length of the step in standard deviations of the posterior, over all parameters
        # together.
        still_to_go = math.sqrt(max(float(-gradient @ step), 0.0))
        size = 1.0
        while True:
            tried = problem.linearise(x + size * step)
            if tried[2] <= cost * (1.0 + 1e-9) or size < 1e-3:
                break
            size *= 0.5
        x = x + size * step
        hessian, gradient, cost, residuals = tried
        costs.append(cost)
        if refits and still_to_go < REFIT_STEP:
            # How wavy the windows are is told by the residuals near the solution. Another prior counts the same place
            # anew: earlier costs move with it, so that they stay comparable.
            refits -= 1
            problem.refit(hessian, gradient, x)
            before = cost
            hessian, gradient, cost, residuals = problem.linearise(x)
            costs = [one + cost - before for one in costs]
        elif still_to_go < chosen.small_step:
            break
    else:
        raise NotConverged(
            f"the adjustment did not converge in {chosen.steps_at_most} steps; check the certificates, the water and "
            f"which points belong to which sphere"
        )
    covariance = solved(hessian, np.eye(problem.size), problem.names)
    rig = problem.rig(x)
    counts = problem.active
    estimates = judged(
        [RIG_PARAMETERS.names[k] for k in counts],
        x[: len(counts)] - problem.mean[: len(counts)],
        problem.prior_sd,
        np.sqrt(np.diag(covariance))[: len(counts)],
    )
    pooled = np.concatenate(residuals)
    rms = float(np.sqrt(np.mean(pooled**2)))
    left = np.concatenate([r.left_px for r in recordings])
    systematic, warnings = warnings_about(
        left,
        pooled,
        chosen.noise_px,
        start.rig.left,
        estimates,
        problem.certificates(x),
        not problem.has_nodes,
    )
    # What differs from recording to recording (a bent plane, a moved bar) cancels in the mean over all of them.
    each = np.repeat(np.arange(len(residuals)), [len(e) for e in residuals])
    rest = max(systematic, systematic_px(left, pooled, start.rig.left, each))
    # What is finer than a patch is not in its mean, but in the residuals beyond their noise.
    rest = max(rest, math.sqrt(max(rms**2 - chosen.noise_px**2, 0.0)))
    bar = next(r for r in recordings if r.kind is ArtefactKind.BALL_BAR)
    noisier = max(1.0, rms / chosen.noise_px)
    # Residuals show what the fields of both cameras differ by. Where the boards in air were adjusted without fields,
    # what these did to lenses and pose there is hidden, and about as large again.
    hidden = problem.has_nodes and start.air_field is None
    # The index of the water is not adjusted: recordings do not tell it from the ports. What the adjustment would have
    # answered to another colour of the LED is carried to the lengths besides.
    _, aside, _, _ = problem.linearise(x, INDEX_STEP)
    by_index = -covariance @ (aside - gradient) / INDEX_STEP
    doubt = Doubt(
        covariance * noisier**2, by_index, _index_sd(bar.water, chosen.led_nm), 2.0 * rest if hidden else rest
    )
    ahead = expected(rig, bar, doubt, problem.columns)
    warnings += warnings_about_expected(ahead, recordings, rest, not hidden)
    shared = expected_depth_error_mm2(rig, bar.water.index, doubt, problem.columns)
    # Rounding leaves the two halves of a product of matrices a last digit apart.
    shared = 0.5 * (shared + shared.T) + 1e-7 * np.eye(len(shared))
    calibration = replace(
        start,
        method=f"bundle, {problem.method.value}",
        made_from=(*start.made_from, *(f"recording {r.name}" for r in recordings)),
        water=recordings[0].water,
        rig=rig,
        residual_px=rms,
        air_covariance=None,
        air_field=None,
        depth_error_mm2=tuple(tuple(row) for row in shared.tolist()),
    )
    bars = sum(r.kind is ArtefactKind.BALL_BAR for r in recordings)
    planes = len(recordings) - bars
    if bars < 2 or planes < 1:
        said = (
            f"{bars} bars and {planes} planes: a scale from one bar in one direction, or tilts without a plane, are "
            f"weakly held; record two bars, turned and leaning, and two planes, near and far"
        )
        warnings += (said,)
    return WaterResult(
        problem.method,
        calibration,
        warnings,
        systematic_px=systematic,
        estimates=estimates,
        costs=tuple(costs),
        expected=ahead,
    )


class Problem:
    """The normal equations of one adjustment. Unknowns: the active rig parameters, spline nodes, artefacts."""

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
        # Priors as an information matrix, that is the inverse of a covariance: independent for the ports, which only
        # the drawing states; for lenses and pose the full covariance of the calibration in air, whose parameters are
        # strongly correlated (principal distance with k1, yaw with the principal point).
        information = np.zeros((count, count))
        information[:6, :6] = np.diag(np.array([tilt, tilt, settings.distance_mm] * 2) ** -2.0)
        if method is not Method.PORTS:
            information[6:, 6:] = np.linalg.inv(_widened(np.array(start.air_covariance), rig, settings))
        self.prior_sd = np.sqrt(np.diag(np.linalg.inv(information)))
        self.has_nodes = method is Method.SPLINE and settings.spline_px > 0.0
        size_px = rig.left.width_px, rig.left.height_px
        self._grid = SplineGrid(size_px) if air_field is None else SplineGrid(size_px, air_field.intervals)
        nodes = 2 * self._grid.count if self.has_nodes else 0
        # Order of the unknowns x: rig parameters, nodes of the left and right image correction, then each artefact's
        # pose.
        self._left_nodes, self._right_nodes = slice(count, count + nodes), slice(count + nodes, count + 2 * nodes)
        placed = [first_place(thinned(r, settings.points_per_recording), rig) for r in recordings]
        self.recordings = [recording for _, recording in placed]
        self._places: list[Place] = [place for place, _ in placed]
        at = self._right_nodes.stop
        self._slices = []
        for place in self._places:
            self._slices.append(slice(at, at + len(place.steps)))
            at += len(place.steps)
        self.size = at
        self.prior = np.zeros((at, at))
        self.prior[:count, :count] = information
        self.mean = np.zeros(at)
        self.windows: FieldPrior | None = None
        """Prior of rig and fields where the calibration in air tells of fields; estimates how wavy the windows are."""
        if self.has_nodes and air_field is not None:
            known = np.zeros((self._right_nodes.stop,) * 2)
            known[:6, :6] = np.linalg.inv(information[:6, :6])
            known[6:, 6:] = _widened(air_field.covariance, rig, settings)
            mean = np.concatenate([np.zeros(6), air_field.mean])
            self.windows = FieldPrior(known, mean, self._grid)
            self.mean[: len(mean)] = mean
            self.prior[: len(mean), : len(mean)] = self.windows.information
            self.prior_sd = np.sqrt(np.diag(known)[:count])
        elif self.has_nodes:
            smooth = smoothness(self._grid.intervals, settings.spline_px, settings.spline_bend_px)
            self.prior[self._left_nodes, self._left_nodes] = smooth
            self.prior[self._right_nodes, self._right_nodes] = smooth

    def rig(self, x: Array) -> StereoRig:
        """Return the rig at ``x``, with its corrections."""
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
        """Names of all unknowns, in order."""
        named = [RIG_PARAMETERS.names[k] for k in self.active]
        for side, at in zip(SIDES, (self._left_nodes, self._right_nodes), strict=True):
            named += [f"{side} image correction"] * (at.stop - at.start)
        for recording, at in zip(self.recordings, self._slices, strict=True):
            named += [f"the place of {recording.name}"] * (at.stop - at.start)
        return named

    @property
    def columns(self) -> Columns:
        """Places of the rig's unknowns."""
        return Columns(tuple(self.active), (self._left_nodes, self._right_nodes))

    def refit(self, hessian: Array, gradient: Array, x: Array) -> None:
        """Estimate how wavy the windows are, from the normal equations at ``x``, and hold the nodes accordingly."""
        if self.windows is None:
            return
        without = gradient - self.prior @ (x - self.mean)
        self.windows.refit(hessian - self.prior, without, x, REFIT_ROUNDS)
        m = len(self.windows.mean)
        self.prior[:m, :m] = self.windows.information

    def certificates(self, x: Array) -> list[tuple[str, float]]:
        """Return each bar's name and how many standard deviations its length is off its certificate."""
        found = []
        for recording, place, at in zip(self.recordings, self._places, self._slices, strict=True):
            residual, _ = place.certificate(x[at])
            if len(residual):
                found.append((recording.name, float(residual[0])))
        return found

    def linearise(self, x: Array, index_more: float = 0.0) -> tuple[Array, Array, float, list[Array]]:
        """Return Hessian, gradient and cost of the robust sum of squares, and the residuals (n, 2) in px per
        recording; in water whose index is ``index_more`` than stated."""
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
        for recording, place, at in zip(self.recordings, self._places, self._slices, strict=True):
            slopes = self.slopes(x, rig, changed, recording, place, at, index_more)
            residual = slopes.residual
            far = np.linalg.norm(residual, axis=1) / noise / self.settings.far_residual
            # Huber's weight, from the length of the residual so that both coordinates of one match lose alike: 1 inside
            # far_residual, 1/far outside.
            weight = np.tile(1.0 / np.maximum(far, 1.0) / noise**2, 2)
            slopes.add(hessian, gradient, weight)
            k2 = self.settings.far_residual**2
            # ρ of Huber: r² inside, 2 r − 1 outside, in units of far_residual; continuous in value and slope at 1.
            cost += float(np.sum(np.where(far <= 1.0, far**2, 2.0 * far - 1.0)) * k2)
            extra, D = place.certificate(x[at])
            hessian[at, at] += D.T @ D
            gradient[at] += D.T @ extra
            cost += float(extra @ extra)
            residuals.append(residual)
        return hessian, gradient, cost, residuals

    def slopes(
        self,
        x: Array,
        rig: StereoRig,
        changed: Sequence[tuple[StereoRig, float]],
        recording: Recording,
        place: Place,
        at: slice,
        index_more: float,
    ) -> Slopes:
        """Return one recording's residuals and their slopes by all unknowns; ``changed`` has the rigs at a step of each
        of the first."""
        index = recording.water.index + index_more
        left, right = recording.left_px, recording.right_px
        if self.has_nodes:
            left_basis, right_basis = NodeBasis.at(left, self._grid), NodeBasis.at(right, self._grid)
            left = left - left_basis.surface(x[self._left_nodes])
            right = right - right_basis.surface(x[self._right_nodes])

        def predicted(rig: StereoRig, uv: Array = left, q: Array = x[at]) -> Array:
            # Transfer error: left pixel → refracted ray → point on the artefact → refracted projection into the right
            # camera. Both coordinates count: the one across the epipolar line tells a tilted port.
            return rig.right.project(place.meet(*rig.left.rays(uv, index), recording.sphere, q), index)

        now = predicted(rig)
        # Forward differences: refraction has no handy closed derivative, and the functions are smooth far below the
        # steps.
        parts = [np.stack([(predicted(other) - now) / step for other, step in changed], -1)]
        parts.append(np.stack([(predicted(rig, q=x[at] + e) - now) / e.max() for e in np.diag(place.steps)], -1))
        columns = np.concatenate([np.arange(len(changed)), np.arange(at.start, at.stop)])
        nodes: list[NodeSlopes] = []
        if self.has_nodes:
            # The left correction is subtracted before the ray, the right one from the matched pixel.
            by_left = [(predicted(rig, uv=left - e) - now) / PIXEL_STEP for e in PIXEL_STEP * np.eye(2)]
            nodes.append(NodeSlopes(self._left_nodes, left_basis, by_left))
            nodes.append(NodeSlopes(self._right_nodes, right_basis, list(np.eye(2))))
        return Slopes(now - right, np.concatenate(parts, -1), columns, nodes)

    def _corrected(self, camera: HousedCamera, nodes: Array) -> HousedCamera:
        return replace(camera, correction=self._grid.correction(nodes.reshape(2, -1).T))

    def bare(self, x: Array) -> StereoRig:
        """Return the rig at ``x``, without its corrections."""
        return RIG_PARAMETERS.changed(self.start.rig, x[: len(self.active)], self.active)


def _index_sd(water: Water, led_nm: float) -> float:
    """Return the standard deviation of the water's index for light whose wavelength has that of ``led_nm``."""
    redder, bluer = (replace(water, wavelength_nm=water.wavelength_nm + nm).index for nm in (1.0, -1.0))
    return abs(redder - bluer) / 2.0 * led_nm


def _widened(covariance: Array, rig: StereoRig, settings: BundleSettings) -> Array:
    """Return the covariance of the values from air (22, or more that follow them) in water."""
    # Between air and water the mount may give and the focus may creep: both widen the prior, else the adjustment would
    # push what happened there into the ports.
    widened = covariance.copy()
    widened[16:19, 16:19] += np.eye(3) * math.radians(settings.mount_deg) ** 2
    widened[19:22, 19:22] += np.eye(3) * settings.mount_mm**2
    for k, camera in ((0, rig.left), (8, rig.right)):
        widened[k, k] += (settings.refocus * camera.lens.f_px[0]) ** 2
    return widened


def smoothness(intervals: tuple[int, int], value_sd: float, bend_sd: float) -> Array:
    """Return the information matrix of one camera's nodes: small values, small second differences along rows and
    columns."""
    # A cubic B-spline over n intervals has n + 3 coefficients. The information is I / value_sd² + BᵀB / bend_sd² with B
    # the second differences: a thin-plate prior without a null space.
    columns, rows = intervals[0] + 3, intervals[1] + 3
    across, down = np.diff(np.eye(columns), 2, axis=0), np.diff(np.eye(rows), 2, axis=0)
    bends = np.concatenate([np.kron(np.eye(rows), across), np.kron(down, np.eye(columns))])
    one = np.eye(columns * rows) / value_sd**2 + bends.T @ bends / bend_sd**2
    return np.asarray(np.kron(np.eye(2), one))
