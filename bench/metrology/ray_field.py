"""Free field of rays about the refractive model, the published outlook: the method SPLINE with a shift of every ray."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from appliance.calibrate.recordings import Recording
from appliance.calibrate.water.artefact import ArtefactPose
from appliance.calibrate.water.bundle import (
    BundleSettings,
    NodeBasis,
    NodeJacobian,
    Problem,
    RecordingJacobian,
    smoothness,
    solve_problem,
)
from appliance.calibrate.water.method import Method
from appliance.measure.calibration.file import Calibration
from appliance.measure.light.correction import SplineGrid
from appliance.measure.light.model import HousedCamera, StereoRig
from appliance.measure.light.ray_shift import INTERVALS, RayShift

Array = NDArray[np.float64]

SHIFT_SD_MM, BEND_SD_MM = 0.02, 0.01
"""Prior standard deviations of the shift's nodes, and of their second differences."""
STEP_MM = 1e-3


def calibrate_ray_field(recordings: Sequence[Recording], start: Calibration) -> Calibration:
    """Calibrate with ray shifts from ten recordings or more; with fewer the model fits only those. Raises
    RecordingError."""
    return solve_problem(FieldProblem(recordings, start, Method.SPLINE, BundleSettings())).calibration


class FieldProblem(Problem):
    """Normal equations of SPLINE with the nodes of both cameras' ray shifts after its parameters, left first."""

    def __init__(
        self, recordings: Sequence[Recording], start: Calibration, method: Method, settings: BundleSettings
    ) -> None:
        super().__init__(recordings, start, method, settings)
        information = smoothness(INTERVALS, SHIFT_SD_MM, BEND_SD_MM)
        first, count = self.size, len(information)
        self.shifts = slice(first, first + count), slice(first + count, first + 2 * count)
        """Columns of the left and the right nodes among the parameters."""
        self.size += 2 * count
        self.mean = np.concatenate([self.mean, np.zeros(2 * count)])
        self.prior = block_diag(self.prior, information, information)

    @property
    def names(self) -> list[str]:
        """Names of all parameters, in order."""
        names = super().names
        return names + ["a ray shift"] * (self.size - len(names))

    def rig(self, x: Array) -> StereoRig:
        """Return the rig at ``x``, with its corrections and ray shifts."""
        rig = super().rig(x)
        left, right = (
            _with_shift(camera, x[part]) for camera, part in zip((rig.left, rig.right), self.shifts, strict=True)
        )
        return replace(rig, left=left, right=right)

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
        """Return the residuals of one recording and their Jacobian by all parameters."""
        grid = SplineGrid((rig.left.width_px, rig.left.height_px), INTERVALS)
        bases = [NodeBasis.at(uv, grid) for uv in (recording.left_px, recording.right_px)]
        # The right shift is evaluated at the matched pixel instead of the projected point, as the shifts are smooth.
        left_mm, right_mm = (basis.surface(x[part_nodes]) for basis, part_nodes in zip(bases, self.shifts, strict=True))

        def shifted(rig: StereoRig, left_mm: Array = left_mm, right_mm: Array = right_mm) -> StereoRig:
            return replace(rig, left=_shifted(rig.left, left_mm), right=_shifted(rig.right, right_mm))

        steps = STEP_MM * np.eye(2)
        shifted_rigs = [shifted(rig, left_mm=left_mm + e) for e in steps] + [
            shifted(rig, right_mm=right_mm + e) for e in steps
        ]
        rigs = [
            *((shifted(changed_rig), step) for changed_rig, step in changed),
            *((rig_shift, STEP_MM) for rig_shift in shifted_rigs),
        ]
        jacobian = super().slopes(x, shifted(rig), rigs, recording, pose, part, index_change)
        first = len(changed)
        by_shift = [jacobian.dense[:, :, k] for k in range(first, len(rigs))]
        nodes = [
            NodeJacobian(part_nodes, basis, slopes)
            for part_nodes, basis, slopes in zip(self.shifts, bases, (by_shift[:2], by_shift[2:]), strict=True)
        ]
        columns = np.r_[:first, len(rigs) : jacobian.dense.shape[2]]
        return RecordingJacobian(
            jacobian.residual, jacobian.dense[:, :, columns], jacobian.columns[columns], [*jacobian.nodes, *nodes]
        )


@dataclass(frozen=True, slots=True)
class _ShiftedCamera(HousedCamera):
    """Camera for the pixels of one recording, with a shift of each ray."""

    by_mm: Array = field(default_factory=lambda: np.zeros(3))
    """(n, 3), left camera frame."""

    def rays(self, uv_px: Array, water_index: float) -> tuple[Array, Array]:
        """Return the rays of these pixels as ``HousedCamera.rays`` does."""
        origin, direction = HousedCamera.rays(self, uv_px, water_index)
        return origin + self.by_mm, direction

    def project(self, points_mm: Array, water_index: float) -> Array:
        """Return the pixels of points (n, 3) that are seen along these rays."""
        return HousedCamera.project(self, points_mm - self.by_mm, water_index)


def _shifted(camera: HousedCamera, shift_mm: Array) -> _ShiftedCamera:
    by_mm = shift_mm @ np.asarray(camera.rotation)[:, :2].T
    return _ShiftedCamera(
        camera.width_px,
        camera.height_px,
        camera.lens,
        camera.port,
        camera.rotation,
        camera.translation_mm,
        by_mm=by_mm,
    )


def _with_shift(camera: HousedCamera, nodes: Array) -> HousedCamera:
    by_node = nodes.reshape(2, -1).T.ravel()
    return replace(camera, ray_shift=RayShift(camera.width_px, camera.height_px, INTERVALS, tuple(by_node.tolist())))
