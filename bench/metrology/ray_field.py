"""Owns the free field of rays about the refractive model, the published outlook: what the spline adjusts, and a shift of every ray."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from appliance.calibrate.recordings import Recording
from appliance.calibrate.water.artefact import Place
from appliance.calibrate.water.bundle import (
    BundleSettings,
    NodeBasis,
    NodeSlopes,
    Problem,
    Slopes,
    adjusted,
    smoothness,
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
    """Adjust it to ten recordings or more: from fewer it follows them and nothing else. Raises RecordingError."""
    return adjusted(FieldProblem(recordings, start, Method.SPLINE, BundleSettings())).calibration


class FieldProblem(Problem):
    """The spline's normal equations; after its unknowns come the nodes of the left and of the right camera's ray shift."""

    def __init__(
        self, recordings: Sequence[Recording], start: Calibration, method: Method, settings: BundleSettings
    ) -> None:
        super().__init__(recordings, start, method, settings)
        held = smoothness(INTERVALS, SHIFT_SD_MM, BEND_SD_MM)
        first, count = self.size, len(held)
        self.shifts = slice(first, first + count), slice(first + count, first + 2 * count)
        """Places of the left and of the right nodes among the unknowns."""
        self.size += 2 * count
        self.mean = np.concatenate([self.mean, np.zeros(2 * count)])
        self.prior = block_diag(self.prior, held, held)

    @property
    def names(self) -> list[str]:
        """Names of all unknowns, in order."""
        known = super().names
        return known + ["a ray shift"] * (self.size - len(known))

    def rig(self, x: Array) -> StereoRig:
        """Return the rig at ``x``, with its corrections and ray shifts."""
        rig = super().rig(x)
        left, right = (
            _with_shift(camera, x[at]) for camera, at in zip((rig.left, rig.right), self.shifts, strict=True)
        )
        return replace(rig, left=left, right=right)

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
        """Return one recording's residuals and their slopes by all unknowns."""
        grid = SplineGrid((rig.left.width_px, rig.left.height_px), INTERVALS)
        bases = [NodeBasis.at(uv, grid) for uv in (recording.left_px, recording.right_px)]
        # The right shift is looked up at the matched pixel, not where the point falls: they are coarse.
        left_mm, right_mm = (basis.surface(x[where]) for basis, where in zip(bases, self.shifts, strict=True))

        def shifted(rig: StereoRig, left_mm: Array = left_mm, right_mm: Array = right_mm) -> StereoRig:
            return replace(rig, left=_shifted(rig.left, left_mm), right=_shifted(rig.right, right_mm))

        steps = STEP_MM * np.eye(2)
        moved = [shifted(rig, left_mm=left_mm + e) for e in steps] + [
            shifted(rig, right_mm=right_mm + e) for e in steps
        ]
        rigs = [*((shifted(one), step) for one, step in changed), *((one, STEP_MM) for one in moved)]
        found = super().slopes(x, shifted(rig), rigs, recording, place, at, index_more)
        first = len(changed)
        by_shift = [found.dense[:, :, k] for k in range(first, len(rigs))]
        nodes = [
            NodeSlopes(where, basis, slopes)
            for where, basis, slopes in zip(self.shifts, bases, (by_shift[:2], by_shift[2:]), strict=True)
        ]
        others = np.r_[:first, len(rigs) : found.dense.shape[2]]
        return Slopes(found.residual, found.dense[:, :, others], found.columns[others], [*found.nodes, *nodes])


@dataclass(frozen=True, slots=True)
class _ShiftedCamera(HousedCamera):
    """A camera for the pixels of one recording: the rays of each are shifted by so much."""

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
