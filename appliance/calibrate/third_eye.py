"""The projector as the third eye of a calibration: learnt from its first normal scans, and from then on a check of it.

Points of two cameras say where a projector stands that nobody has calibrated (``measure.motion.projector``). The first
normal scans of a calibration teach it; the fit is kept with the calibration and never made again, so that what happens to
the instrument later shows against it. Where the two rays of a point meet, a third surface passes: all that the projector
lights with the point's pattern column. Its distance is the **third gap**, and it must be zero like the ray gap of the two.

A camera that turns about y moves every point along its rays, and the ray gap stays; the third gap is what the columns
moved by: 93 µm for 0.02°. Over the image it is judged as the ray gap is, by a reference, amplitudes and their sum
(``calibrate.health``); its four patterns are

    even      the same everywhere: turns about y
    across    opposite at left and right: principal distances
    down      opposite at top and bottom: turns about x and z
    corners   opposite at neighbouring corners

The fit lies in a small sealed file beside the health's, with the hash of its calibration:

    <root>/calibration/health/<first 16 digits of the calibration's hash>.projector.json
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from appliance.base import SealedFile, digest
from appliance.calibrate.health import FOLDER, HealthJudgement, HealthTrend, LearntFile, ThirdTrend, judge_health
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
class SeenScan:
    """A scan as far as it shows the projector."""

    water_index: float
    left_px: tuple[tuple[float, float], ...]
    right_px: tuple[tuple[float, float], ...]
    pattern_px: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class ThirdEye:
    """The projector as a calibration's first scans show it."""

    scans: tuple[SeenScan, ...] = ()
    """Those that it will be fitted to; none once it is."""
    camera: HousedCamera | None = None
    """The projector as a camera in the left camera frame; ``None``: not fitted yet."""
    misfit_px: float | None = None
    """Robust standard deviation of a coordinate of these scans against it."""

    @property
    def hash(self) -> str:
        """SHA-256 of the fit."""
        return digest(EYE.content(self))

    def shown(self, rig: StereoRig, gaps: PatchGaps) -> ThirdEye:
        """Return what is known after one more normal scan; nothing changes once the projector is fitted."""
        if self.camera is not None or gaps.sample_px is None or gaps.pattern_size_px is None:
            return self
        few = gaps.sample_px[:: max(1, len(gaps.sample_px) // POINTS_PER_SCAN)].astype(np.float64)
        pairs = (tuple((float(a), float(b)) for a, b in few[:, k : k + 2]) for k in (0, 2, 4))
        scans = (*self.scans, SeenScan(gaps.water_index, *pairs))
        if len(scans) < FITTED_SCANS:
            return replace(self, scans=scans)
        fitted = fit_projector_to(rig, [_points(rig, one) for one in scans], gaps.pattern_size_px)
        # A calibration so strange that its points mean nothing fits no projector, either.
        finite = np.isfinite(fitted.residual_px)
        return ThirdEye(camera=fitted.camera, misfit_px=fitted.residual_px) if finite else ThirdEye()

    def gaps(self, rig: StereoRig, gaps: PatchGaps) -> PatchGaps | None:
        """Return the third gaps of a scan whose ray gaps are given; ``None`` where the projector is not fitted yet."""
        if self.camera is None or gaps.sample_px is None:
            return None
        sample_px, index = gaps.sample_px.astype(np.float64), gaps.water_index
        off_px = _off_px(self.camera, rig, index, sample_px)
        # NaN: rays that meet where the projector lights nothing.
        known = np.isfinite(off_px)
        sample_px, off_px = sample_px[known], off_px[known]
        patch = PatchGaps.patch_of(sample_px[:, 0:2], (rig.left.width_px, rig.left.height_px))
        kept, good, noise_px = true_matches(patch, off_px, FEWEST_IN_PATCH)
        counts = np.bincount(patch[kept], minlength=PatchGaps.COUNT)[good]

        def mean(values: Array) -> Array:
            return np.asarray(np.bincount(patch[kept], values[kept], minlength=PatchGaps.COUNT)[good] / counts)

        # One point of each patch tells how wide a column is there, and how the amplitudes answer to turns.
        middle_px = np.stack([mean(column) for column in sample_px.T], -1)
        um_per_px = _um_per_px(self.camera, rig, index, middle_px)
        modes = _patterns(middle_px[:, 0:2], rig)
        turns_um, at_rest_px = [], _off_px(self.camera, rig, index, middle_px)
        for name in TURNS:
            k = RIG_PARAMETERS.names.index(name)
            turned = RIG_PARAMETERS.changed(rig, RIG_PARAMETERS.steps[k], k)
            answer_um = um_per_px * (_off_px(self.camera, turned, index, middle_px) - at_rest_px)
            turns_um.append(np.radians(np.linalg.lstsq(modes, answer_um, rcond=None)[0] / RIG_PARAMETERS.steps[k]))
        return PatchGaps(
            patch=good,
            gap_um=um_per_px * mean(off_px),
            noise_um=um_per_px * noise_px,
            modes=modes,
            samples=len(off_px),
            water_index=index,
            turns_um=np.stack(turns_um),
        )


def judge_with_projector(
    trend: HealthTrend, eye: ThirdEye, rig: StereoRig, gaps: PatchGaps, scan: str | None = None
) -> tuple[HealthTrend, ThirdEye, HealthJudgement]:
    """Return trend and projector after one more scan, and what is to be said about it, as ``judge_health`` does."""
    third = eye.gaps(rig, gaps)
    if third is not None and trend.third.projector != eye.hash:
        # Another fit than the one that was judged against: it was lost and is learnt anew.
        trend = replace(trend, third=ThirdTrend(projector=eye.hash))
    after, said = judge_health(trend, gaps, scan, third)
    if said.normal:
        eye = eye.shown(rig, gaps)
    return after, eye, said


def _points(rig: StereoRig, scan: SeenScan) -> ShownPoints:
    points = triangulate(rig, np.array(scan.left_px), np.array(scan.right_px), scan.water_index)
    return ShownPoints(scan.water_index, points, np.array(scan.pattern_px))


def _off_px(projector: HousedCamera, rig: StereoRig, water_index: float, seen_px: Array) -> Array:
    """Return by how many columns (n,) matches (n, 6), as ``PatchGaps.sample_px`` has them, are beside the projector's."""
    points = triangulate(rig, seen_px[:, 0:2], seen_px[:, 2:4], water_index)
    return np.asarray(seen_px[:, 4] - projector.project(points, water_index)[:, 0])


def _um_per_px(projector: HousedCamera, rig: StereoRig, water_index: float, seen_px: Array) -> Array:
    """Return the width (n,) of a projector's column where the rays of matches (n, 6) meet, across its axis."""
    points = triangulate(rig, seen_px[:, 0:2], seen_px[:, 2:4], water_index)
    aside_mm = 0.5 * np.asarray(projector.rotation)[:, 0]
    one, other = (projector.project(points + shift, water_index)[:, 0] for shift in (aside_mm, -aside_mm))
    return np.asarray(1000.0 / (one - other))


def _patterns(left_px: Array, rig: StereoRig) -> Array:
    """Return the four patterns (n, 4) at left pixels (n, 2), each of RMS 1 over the whole image."""
    x, y = (2.0 * left_px / [rig.left.width_px - 1, rig.left.height_px - 1] - 1.0).T
    return np.stack([np.ones_like(x), np.sqrt(3.0) * x, np.sqrt(3.0) * y, 3.0 * x * y], -1)


def _refuse_impossible(eye: ThirdEye) -> None:
    """Raises ValueError."""
    if (eye.camera is None) != (eye.misfit_px is None):
        raise ValueError("a fitted projector and its misfit_px belong together")
    for scan in eye.scans:
        if not len(scan.left_px) == len(scan.right_px) == len(scan.pattern_px):
            raise ValueError("a scan's lists have different lengths")


EYE = SealedFile(ThirdEye, schema=1, max_bytes=1_000_000, indent=None, check=_refuse_impossible)


def third_eye_file(root: Path, calibration_hash: str, fs: FileSystem | None = None) -> LearntFile[ThirdEye]:
    """Return the file of one calibration's projector."""
    path = root / FOLDER / f"{calibration_hash[:16]}.projector.json"
    return LearntFile(EYE, ThirdEye(), path, calibration_hash, fs)
