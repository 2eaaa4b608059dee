"""Owns the rungs that are compared: how each makes a calibration of what is known about a hidden rig."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from appliance.calibration.air.adjustment import AirCalibration
from appliance.calibration.file import Calibration
from appliance.calibration.recordings import Recording
from appliance.calibration.water.interface import SearchSettings
from appliance.calibration.water.ladder import LadderSettings, Method, calibrate
from appliance.optics.water import Water
from bench.metrology.air import BOARDS_IN_WATER, boards_in_water
from bench.metrology.poses import CALIBRATION_BARS, CALIBRATION_PLANES
from bench.metrology.poses import Pose as ObjectPose
from hw_sim.truth import TrueRig
from tests.support.calibrating import Pose, calibration_recordings
from tests.support.truth import WATER

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

    air: AirCalibration
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
    method: Method
    needs: tuple[str, ...] = ()
    """Names of recordings."""
    settings: LadderSettings = field(default_factory=LadderSettings)
    others: int = 0
    """Boards, and recordings that are made point by point."""


AS_PUBLISHED = LadderSettings(search=SearchSettings(noise_free=False))
WAYS: Mapping[str, _Way] = {
    "pm_mapped": _Way(Method.PM_MAPPED),
    "pm_water": _Way(Method.PM_WATER, others=BOARDS_IN_WATER),
    "paper_rm_printed": _Way(Method.PAPER_RM_PRINTED, FOUR, AS_PUBLISHED),
    "rm": _Way(Method.RM, FOUR, AS_PUBLISHED),
    "rm_noise_free": _Way(Method.RM, FOUR),
    "rmd": _Way(Method.RMD, FOUR, AS_PUBLISHED),
    "ba_ports": _Way(Method.BA_PORTS, FOUR),
    "ba_all": _Way(Method.BA_ALL, FOUR),
    "ba_spline_4": _Way(Method.BA_SPLINE, FOUR),
    "ba_spline_4_points": _Way(Method.BA_SPLINE, others=len(FOUR)),
    "ba_spline_10": _Way(Method.BA_SPLINE, ALL),
    "ray_field": _Way(Method.RAY_FIELD, ALL),
}
"""By name, in the order of the tables. ``ba_spline_4_points`` is calibrated with correspondences that were made point by
point, as if images added nothing but noise."""
POINTS = "ba_spline_4_points"
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
        recordings = _points(known.truth) if name == POINTS else [known.recordings[need] for need in way.needs]
        boards = boards_in_water(known.truth) if way.method is Method.PM_WATER else ()
        begun = time.process_time()
        result = calibrate(way.method, recordings, known.start, known.air, way.settings, boards=boards)
        seconds = time.process_time() - begun
        made.append(Made(name, result.calibration, WATER, len(way.needs) + way.others, seconds))
    return made


def _points(truth: TrueRig) -> list[Recording]:
    """The published four as if images added nothing but noise."""
    bars, planes = ([Pose(pose[:3], pose[3:]) for pose in p[:2]] for p in (CALIBRATION_BARS, CALIBRATION_PLANES))
    return calibration_recordings(truth, bars, planes)
