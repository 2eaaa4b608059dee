"""Owns the rungs that are compared: how each makes a calibration of what is known about a hidden rig."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

from appliance.calibration.air import AirCalibration, calibrate_air
from appliance.calibration.bundle import Rung, adjust
from appliance.calibration.file import Calibration
from appliance.calibration.interface import SearchSettings, search_distances
from appliance.calibration.operator import search_with_operator
from appliance.calibration.recordings import Recording
from appliance.optics.model import HousedCamera, StereoRig
from appliance.optics.printed import PrintedCamera
from appliance.optics.water import Water
from bench.metrology.air import BOARDS_IN_WATER, boards_in_water
from bench.metrology.poses import CALIBRATION_BARS, CALIBRATION_PLANES
from bench.metrology.poses import Pose as ObjectPose
from hw_sim.truth import TrueRig
from tests.support.calibrating import Pose, calibration_recordings
from tests.support.pinhole import STRAIGHT, as_pinholes
from tests.support.truth import WATER

PLACES: Mapping[str, tuple[str, ObjectPose]] = {
    **{f"bar {k}": ("ballbar", pose) for k, pose in enumerate(CALIBRATION_BARS)},
    **{f"plane {k}": ("plane", pose) for k, pose in enumerate(CALIBRATION_PLANES)},
}
"""Recordings to calibrate with: what is put before the instrument, and where."""
FOUR = ("bar 0", "bar 1", "plane 0", "plane 1")
"""The published effort: two bars and two planes."""
ALL = tuple(PLACES)
PRINTED_REACH_MM = 8.0
"""The printed formula wants another d than a window has."""


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """What calibrating a rig may use."""

    air: AirCalibration
    start: Calibration
    """Air's lenses and pose, the drawing's ports."""
    recordings: Mapping[str, Recording]
    """From images, by name."""
    truth: TrueRig
    """Only for boards and recordings that are made point by point; no rung reads it."""

    def four(self) -> list[Recording]:
        """The published four."""
        return [self.recordings[name] for name in FOUR]


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
    make: Callable[[Known], Calibration]
    needs: tuple[str, ...]
    """Names of recordings."""
    water: Water = WATER
    others: int = 0
    """Recordings that are made point by point."""


def _bundle(known: Known, recordings: Sequence[Recording], rung: Rung) -> Calibration:
    return adjust(recordings, known.start, rung, known.air.covariance).calibration


def _pinholes_in_water(known: Known) -> Calibration:
    left = known.start.rig.left
    views = boards_in_water(known.truth)
    return replace(known.start, rig=calibrate_air(views, left.width_px, left.height_px).rig)


def _printed(known: Known) -> Calibration:
    rig = known.start.rig
    start = replace(known.start, rig=StereoRig(_as_printed(rig.left), _as_printed(rig.right)))
    return search_distances(known.four(), start, SearchSettings(PRINTED_REACH_MM, noise_free=False)).calibration


def _as_printed(camera: HousedCamera) -> PrintedCamera:
    return PrintedCamera(**{field.name: getattr(camera, field.name) for field in fields(camera)})


def _points(known: Known) -> Calibration:
    bars, planes = ([Pose(pose[:3], pose[3:]) for pose in p[:2]] for p in (CALIBRATION_BARS, CALIBRATION_PLANES))
    return _bundle(known, calibration_recordings(known.truth, bars, planes), Rung.SPLINE)


WAYS: Mapping[str, _Way] = {
    "pm_mapped": _Way(lambda known: replace(known.start, rig=as_pinholes(known.start.rig)), (), STRAIGHT),
    "pm_water": _Way(_pinholes_in_water, (), STRAIGHT, BOARDS_IN_WATER),
    "paper_rm_printed": _Way(_printed, FOUR),
    "rm": _Way(
        lambda known: search_distances(known.four(), known.start, SearchSettings(noise_free=False)).calibration, FOUR
    ),
    "rm_noise_free": _Way(lambda known: search_distances(known.four(), known.start).calibration, FOUR),
    "rmd": _Way(
        lambda known: search_with_operator(known.four(), known.start, SearchSettings(noise_free=False)).calibration,
        FOUR,
    ),
    "ba_ports": _Way(lambda known: _bundle(known, known.four(), Rung.PORTS), FOUR),
    "ba_all": _Way(lambda known: _bundle(known, known.four(), Rung.ALL), FOUR),
    "ba_spline_4": _Way(lambda known: _bundle(known, known.four(), Rung.SPLINE), FOUR),
    "ba_spline_4_points": _Way(_points, (), others=len(FOUR)),
    "ba_spline_10": _Way(lambda known: _bundle(known, list(known.recordings.values()), Rung.SPLINE), ALL),
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
        begun = time.process_time()
        calibration = way.make(known)
        count = len(way.needs) + way.others
        made.append(Made(name, calibration, way.water, count, time.process_time() - begun))
    return made
