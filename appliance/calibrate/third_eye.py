"""The projector as a third eye of a calibration: fitted to its first scans, a check of later ones.

The points of two cameras determine the pose of a projector that was never calibrated (``measure.motion.projector``).
The first normal scans of a calibration do so once; the fit is kept with the calibration, so that a later change of the
instrument shows against it. The projector lights a surface with each pattern column, and a point with that column must
lie on it. Its distance from the surface is the **third gap**.

A camera that turns about y moves every point along its rays and leaves the ray gap as it is; the third gap then shows
by how much the columns moved: 93 µm for 0.02°. It is judged over the image as the ray gap is, by a reference,
amplitudes and their sum (``calibrate.health``). Its four patterns are

    even      the same everywhere: turns about y
    across    opposite at left and right: principal distances
    down      opposite at top and bottom: turns about x and z
    corners   opposite at neighbouring corners

The fit lies in a small sealed file beside that of the health, with the hash of its calibration:

    <root>/calibration/health/<first 16 digits of the calibration's hash>.projector.json
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appliance.base import SealedFile, digest
from appliance.calibrate.health import FOLDER, HealthJudgement, HealthTrend, MemoryFile, ThirdTrend, judge_health
from appliance.calibrate.water.artefact import triangulate
from appliance.measure import (
    RIG_PARAMETERS,
    TURNS,
    HousedCamera,
    PatchGaps,
    ShownPoints,
    StereoRig,
    fit_projector_to,
    true_matches,
)
from appliance.store import FileSystem

Array = NDArray[np.float64]

FITTED_SCANS = 3
"""Normal scans that the projector is fitted to."""
POINTS_PER_SCAN = 200
FEWEST_IN_PATCH = 6


@dataclass(frozen=True, slots=True)
class ProjectorSample:
    """Points of one scan to which the projector is fitted."""

    water_index: float
    left_px: tuple[tuple[float, float], ...]
    right_px: tuple[tuple[float, float], ...]
    pattern_px: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class ThirdEye:
    """The projector as the first scans of a calibration show it."""

    scans: tuple[ProjectorSample, ...] = ()
    """Scans to which it will be fitted; empty once it is."""
    camera: HousedCamera | None = None
    """The projector as a camera in the left camera frame; ``None``: not fitted yet."""
    misfit_px: float | None = None
    """Robust standard deviation of the residuals of the pattern coordinates, in px."""

    @property
    def hash(self) -> str:
        """SHA-256 of the fit."""
        return digest(EYE.content(self))

    def with_scan(self, rig: StereoRig, gaps: PatchGaps) -> ThirdEye:
        """Return the third eye after one more normal scan; unchanged once the projector is fitted."""
        if self.camera is not None or gaps.sample_px is None or gaps.pattern_size_px is None:
            return self
        sample_px = gaps.sample_px[:: max(1, len(gaps.sample_px) // POINTS_PER_SCAN)].astype(np.float64)
        pairs = (tuple((float(a), float(b)) for a, b in sample_px[:, k : k + 2]) for k in (0, 2, 4))
        scans = (*self.scans, ProjectorSample(gaps.water_index, *pairs))
        if len(scans) < FITTED_SCANS:
            return replace(self, scans=scans)
        fitted = fit_projector_to(rig, [_points(rig, scan) for scan in scans], gaps.pattern_size_px)
        # With a calibration so wrong that its points mean nothing, no projector can be fitted.
        finite = np.isfinite(fitted.residual_px)
        return ThirdEye(camera=fitted.camera, misfit_px=fitted.residual_px) if finite else ThirdEye()

    def gaps(self, rig: StereoRig, gaps: PatchGaps) -> PatchGaps | None:
        """Return the third gaps of a scan with ray gaps ``gaps``; ``None`` where the projector is not fitted yet."""
        if self.camera is None or gaps.sample_px is None:
            return None
        sample_px, index = gaps.sample_px.astype(np.float64), gaps.water_index
        errors_px = _column_errors_px(self.camera, rig, index, sample_px)
        # NaN where the rays meet outside the projector's light.
        is_finite = np.isfinite(errors_px)
        sample_px, errors_px = sample_px[is_finite], errors_px[is_finite]
        patch = PatchGaps.patch_of(sample_px[:, 0:2], (rig.left.width_px, rig.left.height_px))
        is_match, patches, noise_px = true_matches(patch, errors_px, FEWEST_IN_PATCH)
        counts = np.bincount(patch[is_match], minlength=PatchGaps.COUNT)[patches]

        def mean(values: Array) -> Array:
            return np.asarray(
                np.bincount(patch[is_match], values[is_match], minlength=PatchGaps.COUNT)[patches] / counts
            )

        # One point of each patch gives the width of a column there, and the change of the amplitudes with turns.

        middle_px = np.stack([mean(column) for column in sample_px.T], -1)
        um_per_px = _um_per_px(self.camera, rig, index, middle_px)
        modes = _patterns(middle_px[:, 0:2], rig)
        turns_um, at_rest_px = [], _column_errors_px(self.camera, rig, index, middle_px)
        for name in TURNS:
            k = RIG_PARAMETERS.names.index(name)
            turned = RIG_PARAMETERS.changed(rig, RIG_PARAMETERS.steps[k], k)
            answer_um = um_per_px * (_column_errors_px(self.camera, turned, index, middle_px) - at_rest_px)
            turns_um.append(np.radians(np.linalg.lstsq(modes, answer_um, rcond=None)[0] / RIG_PARAMETERS.steps[k]))
        return PatchGaps(
            patch=patches,
            gap_um=um_per_px * mean(errors_px),
            noise_um=um_per_px * noise_px,
            modes=modes,
            samples=len(errors_px),
            water_index=index,
            turns_um=np.stack(turns_um),
        )


def judge_with_projector(
    trend: HealthTrend, eye: ThirdEye, rig: StereoRig, gaps: PatchGaps, scan: str | None = None
) -> tuple[HealthTrend, ThirdEye, HealthJudgement]:
    """Return trend, projector and judgement after one more scan, as ``judge_health`` does."""
    third = eye.gaps(rig, gaps)
    if third is not None and trend.third.projector != eye.hash:
        # The projector was fitted anew, as after the loss of its file: the reference of the former fit does not apply.
        trend = replace(trend, third=ThirdTrend(projector=eye.hash))
    after, judgement = judge_health(trend, gaps, scan, third)
    if judgement.normal:
        eye = eye.with_scan(rig, gaps)
    return after, eye, judgement


def _points(rig: StereoRig, scan: ProjectorSample) -> ShownPoints:
    points = triangulate(rig, np.array(scan.left_px), np.array(scan.right_px), scan.water_index)
    return ShownPoints(scan.water_index, points, np.array(scan.pattern_px))


def _column_errors_px(projector: HousedCamera, rig: StereoRig, water_index: float, matches_px: Array) -> Array:
    """Return how many columns (n,) beside the projector's matches (n, 6) lie (see ``PatchGaps.sample_px``)."""
    points = triangulate(rig, matches_px[:, 0:2], matches_px[:, 2:4], water_index)
    return np.asarray(matches_px[:, 4] - projector.project(points, water_index)[:, 0])


def _um_per_px(projector: HousedCamera, rig: StereoRig, water_index: float, matches_px: Array) -> Array:
    """Return the width (n,) of a projector column, across the projector's axis, at the points of matches (n, 6)."""
    points = triangulate(rig, matches_px[:, 0:2], matches_px[:, 2:4], water_index)
    aside_mm = 0.5 * np.asarray(projector.rotation)[:, 0]
    plus_px, minus_px = (projector.project(points + shift, water_index)[:, 0] for shift in (aside_mm, -aside_mm))
    return np.asarray(1000.0 / (plus_px - minus_px))


def _patterns(left_px: Array, rig: StereoRig) -> Array:
    """Return the four patterns (n, 4) at left pixels (n, 2), each of RMS 1 over the whole image."""
    x, y = (2.0 * left_px / [rig.left.width_px - 1, rig.left.height_px - 1] - 1.0).T
    return np.stack([np.ones_like(x), np.sqrt(3.0) * x, np.sqrt(3.0) * y, 3.0 * x * y], -1)


def _refuse_impossible(eye: ThirdEye) -> None:
    """Raise ValueError for values that do not fit together."""
    if (eye.camera is None) != (eye.misfit_px is None):
        raise ValueError("a fitted projector and its misfit_px belong together")
    for scan in eye.scans:
        if not len(scan.left_px) == len(scan.right_px) == len(scan.pattern_px):
            raise ValueError("a scan's lists have different lengths")


EYE = SealedFile(ThirdEye, schema=1, max_bytes=1_000_000, indent=None, check=_refuse_impossible)


def third_eye_file(root: Path, calibration_hash: str, fs: FileSystem | None = None) -> MemoryFile[ThirdEye]:
    """Return the file of one calibration's projector."""
    path = root / FOLDER / f"{calibration_hash[:16]}.projector.json"
    return MemoryFile(EYE, ThirdEye(), path, calibration_hash, fs)
