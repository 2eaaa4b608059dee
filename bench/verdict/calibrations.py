"""Calibrations of a simulated scan (the true one, or that of a hidden rig), and errors of a cloud without those of its
calibration.

A calibration turns and shifts the whole world a little (its left camera's axis is not exactly the true one) and bends it by
some hundredths of a millimetre. Both are the same at rest and moving, and are no business of those who undo a motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.water.artefact import triangulate
from appliance.measure.calibration.file import Calibration
from appliance.measure.light.model import HousedCamera, StereoRig
from appliance.measure.light.water import Water
from appliance.measure.points.pipeline import Cloud
from hw_sim.optics.view import TrueView
from hw_sim.truth import TrueRig, project
from tests.support.calibrating import WIDTH_PX as CALIBRATED_PX
from tests.support.gap_scans import calibrated
from tests.support.rendered import Accuracy, RenderedScan
from tests.support.truth import WATER, complete_calibration, left_to_rig, rig_to_left

Array = NDArray[np.float64]

KINDS = ("exact", "calibrated")
TRUTH_SET = "realistic"
GRID_PX = 8
"""Grid spacing of the true points that determine the displacement by the calibration."""


@dataclass(frozen=True, slots=True)
class CloudErrors:
    """A cloud judged."""

    accuracy: Accuracy
    """Against the true surface, once the calibration's turn and shift are taken back."""
    own_rms_mm: float
    """Along the ray, against where the calibration puts a point that is matched without error."""
    residuals: Array
    """(n,): that error in the points' own sigmas, where the pixel meets the surface."""


def calibration_of(kind: str, truth: TrueRig) -> Calibration:
    """Return a calibration of ``KINDS`` for a rig of ``TRUTH_SET``.

    ``exact`` states the truth. ``calibrated`` is estimated from twenty boards in air, and two ball bars and two planes
    in water, at 1600 × 1200.
    """
    exact = complete_calibration(truth)
    if kind == "exact":
        return exact
    if kind != "calibrated":
        raise ValueError(f"calibration '{kind}'; allowed are {', '.join(KINDS)}")
    rig = calibrated(truth.seed).rig
    times = CALIBRATED_PX // truth.left.width_px
    return replace(exact, method="calibrated", rig=StereoRig(binned(rig.left, times), binned(rig.right, times)))


def binned(camera: HousedCamera, times: int) -> HousedCamera:
    """Return the camera with ``times`` × ``times`` binned pixels. Raises ValueError for one with a ray shift."""
    if camera.ray_shift is not None:
        raise ValueError("a camera with a ray shift is not binned; give one of another method")
    lens, correction = camera.lens, camera.correction
    width_px, height_px = camera.width_px // times, camera.height_px // times
    if correction is not None:
        coefficients = tuple(c / times for c in correction.coefficients_px)
        correction = replace(correction, width_px=width_px, height_px=height_px, coefficients_px=coefficients)
    fu, fv = lens.f_px
    cu, cv = ((c + 0.5) / times - 0.5 for c in lens.c_px)
    lens = replace(lens, f_px=(fu / times, fv / times), c_px=(cu, cv))
    return replace(camera, width_px=width_px, height_px=height_px, lens=lens, correction=correction)


class TrueScene:
    """True scene of one moment of a scan, and its position by a calibration."""

    def __init__(
        self, scan: RenderedScan, rig: StereoRig, time_s: float, view: TrueView | None = None, water: Water = WATER
    ) -> None:
        """``view``: that of the left camera at ``time_s``, if known."""
        self._scan, self._rig, self._time_s, self._index = scan, rig, time_s, water.index
        self.view = view or scan.renderer.view("left", time_s)
        self._back = self._turn_back()

    def judge(self, cloud: Cloud) -> CloudErrors:
        """Return the errors of a cloud that was made with the rig."""
        truth = self._scan.renderer.truth
        pixel = cloud.pixel.astype(np.int64)
        v, u = np.divmod(pixel, truth.left.width_px)
        met = np.isfinite(self.view.points_rig_mm[v, u]).all(-1)
        uv = np.stack([u, v], -1)[met].astype(np.float64)
        expected = self.calibrated_points(uv, self.view.points_rig_mm[v[met], u[met]])
        _, direction = self._rig.left.rays(uv, self._index)
        errors_mm = np.sum((cloud.points_mm[met] - expected) * direction, -1)
        good = np.isfinite(errors_mm)
        rms = float(np.sqrt(np.mean(errors_mm[good] ** 2))) if good.any() else math.nan
        return CloudErrors(self._accuracy(cloud, pixel), rms, errors_mm[good] / cloud.sigma_mm[met][good])

    def _accuracy(self, cloud: Cloud, pixel: NDArray[np.int64]) -> Accuracy:
        R, a, b = self._back
        points = (cloud.points_mm - a) @ R.T + b
        distance = self._scan.renderer.surface(self._time_s).distance_mm(left_to_rig(self._scan.renderer.truth, points))
        visible = self.view.seen_by_all.ravel()
        has_point = np.zeros(visible.size, bool)
        has_point[pixel] = True
        return Accuracy(
            100.0 * float((has_point & visible).sum()) / float(visible.sum()),
            1e6 * float(np.mean(np.abs(distance) > 1.0)),
            float(np.sqrt(np.mean(distance**2))),
        )

    def calibrated_points(self, uv: Array, points_rig_mm: Array) -> Array:
        """Return the triangulated points of left pixels (n, 2) and true points, with error-free right pixels."""
        right = project(self._scan.renderer.truth, "right", points_rig_mm)
        return triangulate(self._rig, uv, right, self._index)

    def _turn_back(self) -> tuple[Array, Array, Array]:
        """Return the rigid transform from the rig's points to the true left camera frame that fits best (Kabsch)."""
        true_rig = self.view.points_rig_mm
        v, u = np.mgrid[0 : true_rig.shape[0] : GRID_PX, 0 : true_rig.shape[1] : GRID_PX].reshape(2, -1)
        met = np.isfinite(true_rig[v, u]).all(-1)
        true_points = true_rig[v, u][met]
        calibrated = self.calibrated_points(np.stack([u, v], -1)[met].astype(np.float64), true_points)
        true = rig_to_left(self._scan.renderer.truth, true_points)
        finite = np.isfinite(calibrated).all(-1)
        calibrated, true = calibrated[finite], true[finite]
        a, b = calibrated.mean(0), true.mean(0)
        U, _, V = np.linalg.svd((calibrated - a).T @ (true - b))
        return np.asarray(V.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(V.T @ U.T))]) @ U.T), a, b
