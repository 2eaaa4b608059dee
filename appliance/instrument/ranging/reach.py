"""Owns what the laser dots say about where the object is, and whether that is near enough and far enough to scan."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from appliance.measure import STANDARD, WorkingVolume

HYSTERESIS_MM = 4.0
"""A word stays until the distance is so far beyond its limit: hands tremble by 1 to 2 mm."""


@dataclass(frozen=True, slots=True)
class Range:
    """Distance and tilt of the object before the instrument, from the laser dots on it."""

    distance_mm: float
    """Distance on the instrument's axis, from the middle between both projection centres; one dot: the dot's own
    depth."""
    tilt_deg: float | None
    """Turn of the surface about the vertical: positive where its right side is farther. ``None`` with one dot."""
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
    """No dot is seen: nobody knows."""


def reach_of(measured: Range | None, before: Reach = Reach.UNKNOWN, volume: WorkingVolume = STANDARD) -> Reach:
    """Return the word for a distance in a housing's volume; ``before``, the word shown now, is kept while the distance
    is within ``HYSTERESIS_MM`` of the limit it crossed."""
    if measured is None:
        return Reach.UNKNOWN
    distance_mm = measured.distance_mm
    least = volume.nearest_mm + (
        HYSTERESIS_MM if before is Reach.BACK else -HYSTERESIS_MM if before is Reach.OK else 0.0
    )
    most = volume.farthest_mm + (
        HYSTERESIS_MM if before is Reach.OK else -HYSTERESIS_MM if before is Reach.CLOSER else 0.0
    )
    if distance_mm < least:
        return Reach.BACK
    return Reach.CLOSER if distance_mm > most else Reach.OK
