"""Owns how the artefacts must be held: limits of pose, size and fit, and which of them a found artefact breaks first.

The limits are wide enough for hands, and narrow enough that no two steps accept the same pose. Bars tilted in depth are
what the published search of distances needs; which end is nearer, and how the planes lean, changes no result and is not
judged (``docs/calibrate-under-water.md``). Angles are in the rig frame, which follows from the calibration.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.guide import RecordingCheck, Refusal, Step
from appliance.measure import StereoRig, WorkingVolume

Array = NDArray[np.float64]

BAR_TILT_DEG = (20.0, 50.0)
"""Tilts in depth of the bars that are adjusted to; the method wants 35°."""
LEVEL_DEG = 15.0
"""The bar of the verification is tilted in depth by no more."""
HALF_UP_DEG = 45.0
"""Angle against the horizontal below which a bar is lying, and above which it is upright."""
MOST_PLANE_TILT_DEG = 35.0
_PLANES_MM = MappingProxyType({Step.M3: (430.0, 470.0, 515.0), Step.M4: (530.0, 570.0, 620.0)})
"""Distances of the two planes from the standard housing's projection centres, along its axis: least, wanted and most."""
LEAST_FILL_PERCENT = 45.0
"""Share of the left picture that the plane must cover."""
RADIUS_OFF, LENGTH_OFF = 0.1, 0.03
"""Relative deviations of a ball's radius and of the bar's length from the certificate that are accepted before
calibration."""
MOST_RMS_MM = {"ball": 0.3, "plane": 0.6}
"""Uncalibrated ports bend a plane by tenths of a millimetre."""


@dataclass(frozen=True, slots=True, eq=False)
class FoundBar:
    """A ball bar as measured; left camera frame."""

    centres_mm: Array
    """(2, 3)."""
    radii_mm: tuple[float, float]
    rms_mm: float
    points: int


@dataclass(frozen=True, slots=True, eq=False)
class FoundPlane:
    """A plane as measured; left camera frame."""

    centre_mm: Array
    normal: Array
    """Away from the instrument."""
    rms_mm: float
    points: int
    fill_percent: float
    """Part of the left picture that it covers."""


@dataclass(frozen=True, slots=True)
class PlaneReach:
    """Place of a plane before the instrument, along its axis from between the projection centres."""

    nearest_mm: float
    wanted_mm: float
    farthest_mm: float


def plane_place(step: Step, volume: WorkingVolume) -> PlaneReach:
    """Return where the plane of ``step`` (M3 or M4) belongs before a housing of that volume; a bar, anywhere in it."""
    if step not in _PLANES_MM:
        return PlaneReach(volume.nearest_mm, volume.working_mm, volume.farthest_mm)
    return PlaneReach(*(volume.scaled(mm) for mm in _PLANES_MM[step]))


def rig_axes(rig: StereoRig) -> tuple[Array, Array]:
    """Return the rotation (3, 3) and origin of the rig frame in the left camera frame: columns right, down, forward."""
    right = np.asarray(rig.right.translation_mm)
    x = right / np.linalg.norm(right)
    z = np.array([0.0, 0.0, 1.0]) + np.asarray(rig.right.rotation)[:, 2]
    z -= (z @ x) * x
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], axis=1), 0.5 * right


def judge_bar(step: Step, bar: FoundBar, rig: StereoRig, length_mm: float, radius_mm: float) -> RecordingCheck:
    """Judge whether a bar will do for ``step`` (M1, M2 or VERIFY)."""
    axes, _ = rig_axes(rig)
    # Angles in the rig frame: the left camera's own frame is turned by the toe-in.
    along = (bar.centres_mm[1] - bar.centres_mm[0]) @ axes
    length = float(np.linalg.norm(along))
    rise_deg = _degrees(abs(along[1]), abs(along[0]))
    tilt_deg = _degrees(abs(along[2]), float(np.hypot(along[0], along[1])))
    upright = rise_deg > HALF_UP_DEG
    worst_radius = max(bar.radii_mm, key=lambda r: abs(r - radius_mm))
    said = f"bar {length:.3f} mm, {tilt_deg:.1f}° in depth, {rise_deg:.0f}° against the horizontal"

    def check(refusal: Refusal | None, number: float | None) -> RecordingCheck:
        return RecordingCheck(step, refusal, number, bar.points, said)

    # Wrong things first, then wrong poses: advice about the pose of something else would be of no use.
    if abs(worst_radius - radius_mm) > RADIUS_OFF * radius_mm:
        return check(Refusal.WRONG_SIZE, worst_radius)
    if abs(length - length_mm) > LENGTH_OFF * length_mm:
        return check(Refusal.WRONG_SIZE, length)
    if bar.rms_mm > MOST_RMS_MM["ball"]:
        return check(Refusal.BAD_FIT, bar.rms_mm)
    if step is Step.VERIFY:
        return check(Refusal.TILT_LESS, tilt_deg) if tilt_deg > LEVEL_DEG else check(None, bar.rms_mm)
    if upright != (step is Step.M2):
        return check(Refusal.STAND_UP if step is Step.M2 else Refusal.LAY_DOWN, rise_deg)
    low, high = BAR_TILT_DEG
    if tilt_deg < low:
        return check(Refusal.TILT_MORE, tilt_deg)
    if tilt_deg > high:
        return check(Refusal.TILT_LESS, tilt_deg)
    return check(None, bar.rms_mm)


def judge_plane(step: Step, plane: FoundPlane, rig: StereoRig) -> RecordingCheck:
    """Judge whether a plane will do for ``step`` (M3 or M4)."""
    axes, origin = rig_axes(rig)
    distance_mm = float(((plane.centre_mm - origin) @ axes)[2])
    normal = plane.normal @ axes
    tilt_deg = _degrees(float(np.hypot(normal[0], normal[1])), normal[2])
    said = f"plane {distance_mm:.0f} mm away, tilted by {tilt_deg:.1f}°, over {plane.fill_percent:.0f} % of the picture"

    def check(refusal: Refusal | None, number: float | None) -> RecordingCheck:
        return RecordingCheck(step, refusal, number, plane.points, said)

    if plane.rms_mm > MOST_RMS_MM["plane"]:
        return check(Refusal.BAD_FIT, plane.rms_mm)
    where = plane_place(step, rig.volume)
    near, far = where.nearest_mm, where.farthest_mm
    if distance_mm < near:
        return check(Refusal.TOO_NEAR, distance_mm)
    if distance_mm > far:
        return check(Refusal.TOO_FAR, distance_mm)
    if plane.fill_percent < LEAST_FILL_PERCENT:
        return check(Refusal.NOT_FILLED, plane.fill_percent)
    if tilt_deg > MOST_PLANE_TILT_DEG:
        return check(Refusal.TILT_LESS, tilt_deg)
    return check(None, plane.rms_mm)


def _degrees(opposite: float, adjacent: float) -> float:
    return float(np.degrees(np.arctan2(opposite, adjacent)))
