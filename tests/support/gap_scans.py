"""Scans as the calibration's health sees them, point by point: exact optics of the simulator, noise of the matching."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from appliance.calibrate.health import HealthJudgement, HealthTrend, judge_health
from appliance.calibrate.water.artefact import nearest_points
from appliance.calibrate.water.bundle import adjust
from appliance.calibrate.water.method import Method
from appliance.measure.calibration.gaps import GapModes, signed_gap_mm
from appliance.measure.calibration.patches import average
from appliance.measure.cloud import PatchGaps
from appliance.measure.light.model import StereoRig
from hw_sim.truth import TrueRig, project, ray
from tests.support.calibrating import Pose, air_of, calibration_recordings, hidden_rig, record_plane, start_of
from tests.support.truth import WATER

POINTS = 4_000
POINT_NOISE_PX = 0.06
"""Of a match, from camera noise."""
COLUMN_NOISE_PX = 0.1
"""Of a decoded pattern coordinate: a camera pixel sees 2.5 columns."""


@dataclass(frozen=True)
class Calibrated:
    """A hidden rig and what its calibration made of it."""

    truth: TrueRig
    rig: StereoRig
    modes: GapModes


@cache
def calibrated(seed: int, method: Method = Method.SPLINE) -> Calibrated:
    """A realistic rig, calibrated in air and in water as the documents say."""
    truth = hidden_rig("realistic", seed)
    rig = adjust(calibration_recordings(truth), start_of(air_of(truth)), method).calibration.rig
    return Calibrated(truth, rig, GapModes(rig, WATER.index))


def scan(
    made: Calibrated, truth: TrueRig, rng: np.random.Generator, index: float = WATER.index, pattern: bool = False
) -> PatchGaps:
    """A plane at a random pose, every other time far off the middle and turned, so that it covers part of the image; with
    ``pattern``, what the projector shows there is decoded, too."""
    aside = rng.uniform() < 0.5
    pose = Pose(
        (
            float(rng.uniform(-70, 70)) if aside else 0.0,
            float(rng.uniform(-50, 50)) if aside else 0.0,
            float(rng.uniform(455, 585)),
        ),
        (float(rng.uniform(-25, 25)), float(rng.uniform(-25, 25)), float(rng.uniform(-90, 90)) if aside else 0.0),
    )
    seed = int(rng.integers(1 << 30))
    seen = record_plane(truth, pose, "scan", POINTS, POINT_NOISE_PX, seed)
    modes = made.modes if index == made.modes.water_index else GapModes(made.rig, index)
    gap_um = 1000.0 * signed_gap_mm(made.rig, index, seen.left_px, seen.right_px)
    if not pattern:
        return average(modes, seen.left_px, seen.right_px, gap_um)
    # Without noise both rays meet on the plane.
    exact = record_plane(truth, pose, "scan", POINTS, 0.0, seed)
    points = nearest_points(*ray(truth, "left", exact.left_px), *ray(truth, "right", exact.right_px))
    shown = project(truth, "projector", points) + rng.normal(0.0, COLUMN_NOISE_PX, (len(points), 2))
    gaps = average(modes, seen.left_px, seen.right_px, gap_um, shown)
    return replace(gaps, pattern_size_px=(1024, 768))


def follow(trend: HealthTrend, scans: Iterable[PatchGaps]) -> Iterator[tuple[HealthTrend, HealthJudgement]]:
    """The trend after each scan, and what was said."""
    for number, gaps in enumerate(scans, 1):
        trend, judgement = judge_health(trend, gaps, f"{number:06d}")
        yield trend, judgement


def learnt(made: Calibrated, scans: int = 12, seed: int = 1) -> HealthTrend:
    """The trend after that many normal scans."""
    rng = np.random.default_rng([seed, made.truth.seed])
    return [after for after, _ in follow(HealthTrend(), (scan(made, made.truth, rng) for _ in range(scans)))][-1]


def scans_until_alarm(
    made: Calibrated, trend: HealthTrend, truth: TrueRig, most: int, seed: int = 2, index: float = WATER.index
) -> int | None:
    """How many scans of the changed instrument it takes; ``None``: more than ``most``."""
    rng = np.random.default_rng([seed, made.truth.seed])
    for number, (_, said) in enumerate(follow(trend, (scan(made, truth, rng, index) for _ in range(most))), 1):
        if said.alarm:
            return number
    return None


def in_water(truth: TrueRig, index: float) -> TrueRig:
    """The same instrument in other water."""
    return replace(truth, n_water=index)
