"""Owns the drawings of how an artefact is held: as the instrument sees it, and beside that from above or from the side."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibrate import HELD, ArtefactKind, Step, plane_place
from appliance.measure import STANDARD, STANDARD_MM, WorkingVolume

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

SIZE_PX = (180, 180)
SCALE = 2
"""Drawn larger and reduced: smooth lines on displays of any size."""
BALL_MM, HALF_BAR_MM = 15.0, 75.0
PLANE_MM = (125.0, 100.0)
FIELD_MM = 265.0
"""Width in mm that the sketch shows at the working distance: the instrument's field and a margin."""
_INK, _LINE, _SOFT, _BODY, _BRIGHT = 14, 70, 44, 150, 235
_POSES: Mapping[Step, tuple[float, float, float, float]] = MappingProxyType(
    {
        Step.M1: (505.0, 0.0, 35.0, 12.0),
        Step.M2: (515.0, 0.0, -35.0, 90.0),
        Step.M3: (plane_place(Step.M3, STANDARD).wanted_mm, 10.0, 0.0, 0.0),
        Step.M4: (plane_place(Step.M4, STANDARD).wanted_mm, -10.0, 0.0, 0.0),
        Step.VERIFY: (515.0, 0.0, 0.0, -45.0),
    }
)
"""Distance in mm before the standard housing, and turns about x, y, z in degrees, one after the other."""
FROM_THE_SIDE = frozenset({Step.M2, Step.M3, Step.M4})
"""Steps whose tilt in depth shows from the side; that of the others from above."""


def sketch_front(step: Step) -> Picture:
    """Return (h, w) uint8: what the instrument sees, in true perspective. ``step`` is one that records."""
    points, radii = _shape(step)
    # Pinhole: an object of FIELD_MM at the working distance is as wide as the sketch.
    focal = SCALE * SIZE_PX[0] * STANDARD_MM / FIELD_MM
    middle = 0.5 * SCALE * np.array(SIZE_PX)
    seen = middle + focal * points[:, :2] / points[:, 2:]
    picture = _empty()
    if HELD[step] is ArtefactKind.PLANE:
        _face(picture, seen)
    else:
        order = np.argsort(-points[:, 2])  # the farther ball first
        _bar(
            picture,
            seen,
            focal * radii / points[:, 2],
            [_BRIGHT if p[2] <= points[:, 2].min() + 5.0 else _BODY for p in points],
            order,
        )
    return _reduced(picture)


def sketch_depth(step: Step, volume: WorkingVolume = STANDARD) -> Picture:
    """Return (h, w) uint8: the instrument on the left, the water to the right, from above or from the side."""
    points, radii = _shape(step)
    other = points[:, 1] if step in FROM_THE_SIDE else points[:, 0]
    scale = SCALE * SIZE_PX[0] / 360.0
    at = np.stack([(points[:, 2] - 300.0) * scale, 0.5 * SCALE * SIZE_PX[1] + other * scale], -1)
    picture = _empty()
    # All is drawn for the standard housing; objects for a smaller one are smaller, and it is the same drawing.
    ends_mm = (mm * STANDARD_MM / volume.working_mm for mm in (volume.nearest_mm, volume.farthest_mm))
    near, far = (round((mm - 300.0) * scale) for mm in ends_mm)
    cv2.rectangle(picture, (near, 20 * SCALE), (far, (SIZE_PX[1] - 20) * SCALE), (_SOFT,), -1)
    middle = SCALE * SIZE_PX[1] // 2
    cv2.rectangle(picture, (0, middle - 26 * SCALE), (16 * SCALE, middle + 26 * SCALE), (_BODY,), -1)
    cv2.line(picture, (16 * SCALE, middle), (SCALE * SIZE_PX[0], middle), (_LINE,), SCALE, cv2.LINE_AA)
    if HELD[step] is ArtefactKind.PLANE:
        ends = at[[0, 2]]
        cv2.line(picture, _pixel(ends[0]), _pixel(ends[1]), (_BRIGHT,), 6 * SCALE, cv2.LINE_AA)
    else:
        _bar(picture, at, radii * scale, [_BRIGHT, _BRIGHT], np.array([0, 1]))
    return _reduced(picture)


def _shape(step: Step) -> tuple[Array, Array]:
    """Return corners of the plane (4, 3) or centres of the balls (2, 3) in the rig frame, and the balls' radii."""
    distance, *turns = _POSES[step]
    if HELD[step] is ArtefactKind.PLANE:
        x, y = PLANE_MM
        local = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
    else:
        local = np.array([[-HALF_BAR_MM, 0.0, 0.0], [HALF_BAR_MM, 0.0, 0.0]])
    for axis, degrees in enumerate(turns):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        # The plane of each rotation in the order that keeps it right-handed: y-z, z-x, x-y.
        i, j = ((1, 2), (2, 0), (0, 1))[axis]
        turn = np.eye(3)
        turn[i, i] = turn[j, j] = c
        turn[i, j], turn[j, i] = -s, s
        local = local @ turn.T
    return local + np.array([0.0, 0.0, distance]), np.full(len(local), BALL_MM)


def _empty() -> Picture:
    return np.full((SCALE * SIZE_PX[1], SCALE * SIZE_PX[0]), _INK, np.uint8)


def _face(picture: Picture, corners: Array) -> None:
    outline = np.rint(corners).astype(np.int32)
    cv2.fillConvexPoly(picture, outline, (_BODY,), cv2.LINE_AA)
    cv2.polylines(picture, [outline], True, (_BRIGHT,), 2 * SCALE, cv2.LINE_AA)


def _bar(picture: Picture, centres: Array, radii: Array, greys: list[int], order: NDArray[np.intp]) -> None:
    cv2.line(picture, _pixel(centres[0]), _pixel(centres[1]), (_LINE + 20,), 5 * SCALE, cv2.LINE_AA)
    for k in order:
        cv2.circle(picture, _pixel(centres[k]), round(float(radii[k])), (greys[k],), -1, cv2.LINE_AA)


def _pixel(at: Array) -> tuple[int, int]:
    return round(float(at[0])), round(float(at[1]))


def _reduced(picture: Picture) -> Picture:
    return np.asarray(cv2.resize(picture, SIZE_PX, interpolation=cv2.INTER_AREA), np.uint8)
