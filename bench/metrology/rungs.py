"""Rungs of the model ladder: how each calibrates a hidden rig from its recordings."""

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
"""Recordings for calibration: object and pose."""
FOUR = ("bar 0", "bar 1", "plane 0", "plane 1")
"""The published effort: two bars and two planes."""
ALL = tuple(PLACES)


@dataclass(frozen=True, slots=True, eq=False)
class RungInput:
    """Input of a rung: start, recordings and, for simulated recordings, the truth."""

    start: Calibration
    """Lenses and extrinsics from air, nominal ports."""
    recordings: Mapping[str, Recording]
    """Recordings from images, by name."""
    truth: TrueRig
    """Used only to make pictures of boards in water and recordings point by point; no rung reads it."""


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """A calibration, the water in which it is used, and its cost."""

    rung: str
    calibration: Calibration
    water: Water
    recordings: int
    seconds: float
    """CPU time of calibrating."""


@dataclass(frozen=True, slots=True)
class _Way:
    calibrate: Callable[[Sequence[Any], Calibration], Calibration]
    """Function from recordings, or the result of ``make_inputs``, and the start to a calibration."""
    needs: tuple[str, ...] = ()
    """Names of the recordings that it uses."""
    make_inputs: Callable[[TrueRig], Sequence[Any]] | None = None
    """Maker of pictures of boards, or of recordings point by point, instead of recordings."""


def _by(method: Method) -> Callable[[Sequence[Recording], Calibration], Calibration]:
    return lambda recordings, start: calibrate(method, recordings, start).calibration


def _noise_free(points_mm: Array) -> float:
    """Return the range of the cubic through the distances from the plane, over d_r: that of points has their noise as its floor."""
    normal, offset = fit_plane(points_mm)
    terms = cubic((points_mm[:, :2] - points_mm[:, :2].mean(axis=0)) / FIELD_MM)
    off = terms @ np.linalg.lstsq(terms, points_mm @ normal - offset, rcond=None)[0]
    return float(np.ptp(off)) / FIELD_MM


def _pinhole(views: Sequence[BoardView], start: Calibration) -> Calibration:
    """Calibrate as in air, as if there were no port: principal distance and distortion absorb the refraction."""
    rig = calibrate_air(views, start.rig.left.width_px, start.rig.left.height_px, with_field=False).rig
    left, right = (replace(camera, lens_in_water=True) for camera in (rig.left, rig.right))
    return replace(start, method="pinhole in water", rig=replace(start.rig, left=left, right=right))


def _points(truth: TrueRig) -> list[Recording]:
    """Return the four published recordings with noise as the only error of the images."""
    bars, planes = ([Pose(pose[:3], pose[3:]) for pose in p[:2]] for p in (CALIBRATION_BARS, CALIBRATION_PLANES))
    return calibration_recordings(truth, bars, planes)


WAYS: Mapping[str, _Way] = {
    "pm_mapped": _Way(lambda _, start: mapped_through_ports(start, start.water)),
    "pm_water": _Way(_pinhole, make_inputs=boards_in_water),
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
    "ba_spline_4_points": _Way(_by(Method.SPLINE), make_inputs=_points),
    "ba_spline_10": _Way(_by(Method.SPLINE), ALL),
    "ray_field": _Way(calibrate_ray_field, ALL),
}
"""Methods by name, in the order of the tables. ``ba_spline_4_points`` uses correspondences computed point by point, as
if images added only noise."""
LATER = "ba_spline_10"
"""The calibration that is taken from fresh water into salt water, where it is used with that water's index and without."""
IN_SALT = ("salt_updated", "salt_not_updated")


def needed(rungs: Sequence[str]) -> tuple[str, ...]:
    """Return the recordings that ``rungs`` need, in order. Raises KeyError for an unknown rung."""
    names = {name for rung in rungs for name in WAYS[rung].needs}
    return tuple(name for name in ALL if name in names)


def climb(rig_inputs: RungInput, rungs: Sequence[str]) -> list[Made]:
    """Return the calibrations of ``rungs``. Raises the errors of the solvers."""
    results = []
    for name in rungs:
        recipe = WAYS[name]
        inputs = (
            [rig_inputs.recordings[need] for need in recipe.needs]
            if recipe.make_inputs is None
            else recipe.make_inputs(rig_inputs.truth)
        )
        start_s = time.process_time()
        calibration = recipe.calibrate(inputs, rig_inputs.start)
        results.append(Made(name, calibration, WATER, len(inputs), time.process_time() - start_s))
    return results
