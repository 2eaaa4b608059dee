"""The verdicts ``holes``, where the left camera saw a surface, and ``distance``, of the points.

Coverage counts pixels. It cannot distinguish a hole from places where no scan has points: shadow, dark surfaces, and
those that the right camera does not see. A surface is *seen* without a point where pixels are saturated, or where their
Gray code contradicts their phase or jumps; after motion, also where there was a point before compensation. Single
pixels and lines of them are edges. A hole contains a square of three by three grid points.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure.cloud import CloudSummary
from appliance.measure.decode.decoder import Mask
from appliance.measure.fault import Fault, FaultCode
from appliance.measure.light.noise import FULL_DN
from appliance.measure.light.volume import WorkingVolume
from appliance.measure.verdict import Judgement, Verdict

NAME = "holes"
GRID_PX = 400
"""Number of grid points across the left image: a hole is 3 of them wide, 2 mm in the standard housing."""
MOST_HOLES = 0.03
"""Largest share of the seen surface that may lie in holes.

In eleven well exposed scenes at rest it was 0.1 % and less; for a pipe of 1 m at 4, 18, 33 and 72 mm/s 1.0, 3.6, 8.2
and 7.4 %, the latter two without their flange; before a torch 12 % and more.
"""
_LIGHT = 0.5
"""Saturated share of the holes' pixels from which on light is their cause."""
_WITHOUT_COORDINATE = (Mask.SATURATED, Mask.CONTRADICTION, Mask.EDGE)

Mask2D = NDArray[np.bool_]


def grid_step_px(width_px: int) -> int:
    """Return the distance of the grid points in px in an image ``width_px`` wide."""
    return max(1, round(width_px / GRID_PX))


def judge_holes(
    mask: NDArray[np.uint8], dark: NDArray[np.uint8], has_point: Mask2D, before: Mask2D | None = None
) -> Judgement:
    """Judge the holes of a cloud by grid points (h, w) of the left image.

    ``mask`` and ``dark`` frame at the grid points; ``has_point``: whether they have points; ``before``: whether they
    had points before motion compensation; ``None``: not compensated. Numbers: ``hole_percent`` and ``largest_percent``,
    all holes and the largest one, of the seen surface; ``saturated_percent`` of the holes' pixels.
    """
    # Where the dark frame is saturated, the projector adds nothing, and decoding masks the pixel as shadow.
    burnt = dark >= np.uint8(FULL_DN)
    light = burnt | (mask == Mask.SATURATED)
    is_hole = (np.isin(mask, _WITHOUT_COORDINATE) | burnt) & ~has_point
    if before is not None:
        is_hole |= before & ~has_point
    surface = int(has_point.sum()) + int(is_hole.sum())
    if surface == 0:
        return Judgement(Verdict(NAME, None, {}, "no surface is seen"))
    holes = cv2.morphologyEx(is_hole.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    _, _, stats, _ = cv2.connectedComponentsWithStats(holes, connectivity=8)
    count = int(holes.sum())
    share, largest = count / surface, max(stats[1:, cv2.CC_STAT_AREA], default=0) / surface
    in_hole = holes.astype(bool)
    saturated = float(light[in_hole].mean()) if count else 0.0
    numbers: dict[str, float | None] = {
        "hole_percent": 100.0 * share,
        "largest_percent": 100.0 * float(largest),
        "saturated_percent": 100.0 * saturated if count else None,
    }
    if share < MOST_HOLES:
        return Judgement(Verdict(NAME, True, numbers, "no hole where a surface was seen"))
    code, why = FaultCode.PART_MISSING, "its images contradict each other"
    fault_numbers = {"hole_percent": 100.0 * share}
    if saturated >= _LIGHT:
        # Ambient light over half of the scale is no fault of the exposure.
        ambient = float(np.mean(dark[in_hole] >= np.uint8(FULL_DN) // 2))
        code, why = (
            (FaultCode.AMBIENT, "ambient light saturates it")
            if ambient >= _LIGHT
            else (FaultCode.TOO_BRIGHT, "it is saturated")
        )
    text = (
        f"{100.0 * share:.0f} % of the visible surface has no points, {100.0 * float(largest):.0f} % in one hole: {why}"
    )
    return Judgement(Verdict(NAME, False, numbers, f"{code.value}: {text}"), Fault(code, text, fault_numbers))


def judge_distance(summary: CloudSummary, volume: WorkingVolume) -> Judgement:
    """Judge whether the median of the points lies in the working volume; number: ``distance_mm``."""
    name, distance_mm = "distance", summary.distance_mm
    if distance_mm is None:
        return Judgement(Verdict(name, None, {}, "no points"))
    numbers: dict[str, float | None] = {"distance_mm": distance_mm}
    if volume.nearest_mm <= distance_mm <= volume.farthest_mm:
        return Judgement(Verdict(name, True, numbers, "inside of the measuring volume"))
    code = FaultCode.SCAN_NEAR if distance_mm < volume.nearest_mm else FaultCode.SCAN_FAR
    text = (
        f"the middle of the points lies at {distance_mm:.0f} mm, the working volume from {volume.nearest_mm:g} "
        f"to {volume.farthest_mm:g} mm"
    )
    fault = Fault(code, text, {"distance_mm": distance_mm})
    return Judgement(Verdict(name, False, numbers, f"{code.value}: {text}"), fault)
