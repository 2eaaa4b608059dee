"""Owns the rungs that are compared: how each makes a calibration of what is known about a hidden rig."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.air.calibrate import calibrate_air
from appliance.calibrate.air.linearised import BoardView
from appliance.calibrate.recordings import Recording
from appliance.calibrate.water.artefact import fit_plane
from appliance.calibrate.water.bundle import BundleSettings, adjust
from appliance.calibrate.water.calibrate import calibrate
from appliance.calibrate.water.method import Method
from appliance.calibrate.water.paper import FIELD_MM, cubic, mapped_through_ports, search_distances
from appliance.measure.calibration.file import Calibration
from appliance.measure.light.water import Water
from bench.metrology.air import boards_in_water
from bench.metrology.poses import CALIBRATION_BARS, CALIBRATION_PLANES
from bench.metrology.poses import Pose as ObjectPose
from bench.metrology.printed import calibrate_as_printed
from bench.metrology.ray_field import calibrate_ray_field
from hw_sim.truth import TrueRig
from tests.support.calibrating import Pose, calibration_recordings
from tests.support.truth import WATER

Array = NDArray[np.float64]

PLACES: Mapping[str, tuple[str, ObjectPose]] = {
    **{f"bar {k}": ("ballbar", pose) for k, pose in enumerate(CALIBRATION_BARS)},
    **{f"plane {k}": ("plane", pose) for k, pose in enumerate(CALIBRATION_PLANES)},
}
"""Recordings to calibrate with: what is put before the instrument, and where."""
FOUR = ("bar 0", "bar 1", "plane 0", "plane 1")
"""The published effort: two bars and two planes."""
ALL = tuple(PLACES)


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What calibrating a rig may use."""

    start: Calibration
    """Air's lenses and pose, the drawing's ports."""
    recordings: Mapping[str, Recording]
    """From images, by name."""
    truth: TrueRig
    """Only for pictures of boards in water and for recordings made point by point; no rung reads it."""


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """A calibration, the water it is used in, and what it cost."""

    rung: str
    calibration: Calibration
    water: Water
    recordings: int
    seconds: float
    """CPU time of calibrating."""


@dataclass(frozen=True, slots=True)
class _Way:
    calibrate: Callable[[Sequence[Any], Calibration], Calibration]
    """Calibrate from recordings, or from what ``others`` makes, and from the start."""
    needs: tuple[str, ...] = ()
    """Names of recordings."""
    others: Callable[[TrueRig], Sequence[Any]] | None = None
    """Pictures of boards, or recordings that are made point by point, in their place."""


def _by(method: Method) -> Callable[[Sequence[Recording], Calibration], Calibration]:
    return lambda recordings, start: calibrate(method, recordings, start).calibration


def _noise_free(points_mm: Array) -> float:
    """Return the range of the cubic through the distances from the plane, over d_r: that of points has their noise as its floor."""
    normal, offset = fit_plane(points_mm)
    terms = cubic((points_mm[:, :2] - points_mm[:, :2].mean(axis=0)) / FIELD_MM)
    off = terms @ np.linalg.lstsq(terms, points_mm @ normal - offset, rcond=None)[0]
    return float(np.ptp(off)) / FIELD_MM


def _pinhole(views: Sequence[BoardView], start: Calibration) -> Calibration:
    """Calibrate as in air, as if no window were there: principal distance and distortion swallow the refraction as well as they can."""
    found = calibrate_air(views, start.rig.left.width_px, start.rig.left.height_px, with_field=False).rig
    left, right = (replace(camera, lens_in_water=True) for camera in (found.left, found.right))
    return replace(start, method="pinhole in water", rig=replace(start.rig, left=left, right=right))


def _points(truth: TrueRig) -> list[Recording]:
    """The published four as if images added nothing but noise."""
    bars, planes = ([Pose(pose[:3], pose[3:]) for pose in p[:2]] for p in (CALIBRATION_BARS, CALIBRATION_PLANES))
    return calibration_recordings(truth, bars, planes)


WAYS: Mapping[str, _Way] = {
    "pm_mapped": _Way(lambda _, start: mapped_through_ports(start, start.water)),
    "pm_water": _Way(_pinhole, others=boards_in_water),
    "paper_rm_printed": _Way(calibrate_as_printed, FOUR),
    "rm": _Way(lambda recordings, start: search_distances(recordings, start).calibration, FOUR),
    "rm_noise_free": _Way(lambda recordings, start: search_distances(recordings, start, _noise_free).calibration, FOUR),
    "rmd": _Way(_by(Method.PAPER), FOUR),
    "ba_ports": _Way(_by(Method.PORTS), FOUR),
    "ba_all": _Way(
        lambda recordings, start: adjust(recordings, start, Method.SPLINE, BundleSettings(spline_px=0.0)).calibration,
        FOUR,
    ),
    "ba_spline_4": _Way(_by(Method.SPLINE), FOUR),
    "ba_spline_4_points": _Way(_by(Method.SPLINE), others=_points),
    "ba_spline_10": _Way(_by(Method.SPLINE), ALL),
    "ray_field": _Way(calibrate_ray_field, ALL),
}
"""By name, in the order of the tables. ``ba_spline_4_points`` is calibrated with correspondences that were made point by
point, as if images added nothing but noise."""
LATER = "ba_spline_10"
"""The calibration that is taken from fresh water into salt water, where it is used with that water's index and without."""
IN_SALT = ("salt_updated", "salt_not_updated")


def needed(rungs: Sequence[str]) -> tuple[str, ...]:
    """The recordings that some of ``rungs`` ask for, in order. Raises KeyError for an unknown rung."""
    wanted = {name for rung in rungs for name in WAYS[rung].needs}
    return tuple(name for name in ALL if name in wanted)


def climb(known: Known, rungs: Sequence[str]) -> list[Made]:
    """The calibrations of ``rungs``. Raises what the solvers raise."""
    made = []
    for name in rungs:
        way = WAYS[name]
        given = [known.recordings[need] for need in way.needs] if way.others is None else way.others(known.truth)
        begun = time.process_time()
        calibration = way.calibrate(given, known.start)
        made.append(Made(name, calibration, WATER, len(given), time.process_time() - begun))
    return made
