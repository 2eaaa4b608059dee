"""Owns the names of the rungs of the calibration ladder; what each does is in ``ladder``."""

from __future__ import annotations

from enum import Enum


class Method(Enum):
    """Methods of calibrating in water."""

    PM_MAPPED = "pm_mapped"
    """The pinhole nearest to the refracted rays of the ports as drawn. Needs no recording."""
    PM_WATER = "pm_water"
    """A pinhole with distortion, calibrated from boards in this water."""
    RM = "rm"
    """Perpendicular ports, their distances searched (UIDD)."""
    RMD = "rmd"
    """RM, an operator from two planes, and the search once more."""
    PAPER_RM_PRINTED = "paper_rm_printed"
    """RM with Eq. 1 as it was printed. For comparison only: no file carries it."""
    BA_PORTS = "ba_ports"
    """Tilt and distance of both ports; the calibration in air is believed."""
    BA_ALL = "ba_all"
    """Adjust lenses and pose, too, held by the covariance of the calibration in air."""
    BA_SPLINE = "ba_spline"
    """Adjust a smooth image correction, too: the method to use."""
    RAY_FIELD = "ray_field"
    """Adjust a finer correction and a shift of every ray, too. Wants ten recordings and more."""


BY_SCANS = tuple(method for method in Method if method is not Method.PM_WATER)
"""Methods for which scans of bars and planes are enough."""
