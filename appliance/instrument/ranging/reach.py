"""Advice to the diver from the laser dots: about the distance, and where to aim.

Range, Reach, reach_of    distance and tilt of the object, and the advice about the distance
Track, Marks, marks_of    where the dots will appear in the live images: marks for the diver to aim with
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from appliance.instrument.ranging.beams import PointerBeam, RigFrame
from appliance.measure import STANDARD, StereoRig, WorkingVolume

HYSTERESIS_MM = 4.0
"""Distance beyond a limit at which the advice changes: hands tremble by 1 to 2 mm."""


@dataclass(frozen=True, slots=True)
class Range:
    """Distance and tilt of the object before the instrument, from the laser dots on it."""

    distance_mm: float
    """Distance along the instrument's axis from the middle between both projection centres; with one dot its depth."""
    tilt_deg: float | None
    """Rotation of the surface about the vertical: positive where its right side is farther. ``None`` with one dot."""
    sigma_mm: float
    """Standard uncertainty of the distance."""
    dots: int
    """Number of dots found, of the two."""


class Reach(Enum):
    """Advice to the diver about the distance."""

    CLOSER = "CLOSER"
    OK = "OK"
    BACK = "BACK"
    UNKNOWN = "UNKNOWN"
    """No dot is seen."""


def reach_of(measured: Range | None, before: Reach = Reach.UNKNOWN, volume: WorkingVolume = STANDARD) -> Reach:
    """Return the advice for a distance in a housing's volume.

    ``before``, the advice shown now, is kept within ``HYSTERESIS_MM`` of the limit that was crossed.
    """
    if measured is None:
        return Reach.UNKNOWN
    distance_mm = measured.distance_mm
    nearest_mm = volume.nearest_mm + (
        HYSTERESIS_MM if before is Reach.BACK else -HYSTERESIS_MM if before is Reach.OK else 0.0
    )
    farthest_mm = volume.farthest_mm + (
        HYSTERESIS_MM if before is Reach.OK else -HYSTERESIS_MM if before is Reach.CLOSER else 0.0
    )
    if distance_mm < nearest_mm:
        return Reach.BACK
    return Reach.CLOSER if distance_mm > farthest_mm else Reach.OK


Place = tuple[float, float]
"""Position as fractions of an image's width and height, from its upper left corner."""


@dataclass(frozen=True, slots=True)
class Track:
    """Track of one pointer's dot in one image: at the near end, the middle and the far end of the volume."""

    near: Place
    middle: Place
    far: Place


@dataclass(frozen=True, slots=True)
class Marks:
    """Tracks in each camera's image; a pointer whose dot would lie outside has none."""

    left: tuple[Track, ...]
    right: tuple[Track, ...]


def marks_of(rig: StereoRig, frame: RigFrame, water_index: float, beams: tuple[PointerBeam, PointerBeam]) -> Marks:
    """Return the marks of the beams, by the calibration in use, through ports and water."""
    z_mm = np.array([rig.volume.nearest_mm, rig.volume.working_mm, rig.volume.farthest_mm])
    sides = []
    for camera in (rig.left, rig.right):
        tracks = []
        for beam in beams:
            shares = (camera.project(frame.to_left(beam.at(z_mm)), water_index) + 0.5) / (
                camera.width_px,
                camera.height_px,
            )
            if np.isfinite(shares).all() and (shares > 0.0).all() and (shares < 1.0).all():
                tracks.append(Track(*((float(u), float(v)) for u, v in shares)))
        sides.append(tuple(tracks))
    return Marks(sides[0], sides[1])
