"""Effect of motion compensation: scans of moving hands against the same scans at rest.

A cloud is judged against the true surface at its own time, the middle of the x-sines. Every scan is solved twice: with
the calibration that states the truth, and with one that was estimated as an instrument's is (``calibrations.py``).
Errors exclude those of the calibration, which are the same at rest and moving and would make any ratio look good.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from appliance.measure.calibration.file import Calibration
from appliance.measure.cloud import CloudLocation
from appliance.measure.light.model import StereoRig
from appliance.measure.light.noise import TYPICAL_PAIR, StereoNoise
from appliance.measure.light.sides import SIDES
from appliance.measure.light.water import Water
from appliance.measure.motion.attempt import Attempt, attempt
from appliance.measure.points.pipeline import Pipeline
from appliance.measure.verdicts.motion.judge import judge_motion
from bench.result import Measurement
from bench.verdict.calibrations import KINDS, CloudErrors, TrueScene, calibration_of
from bench.verdict.compensation_cases import (
    NAMED,
    Case,
    drawn_case,
    named_cases,
)
from bench.verdict.kept_scans import kept_scan
from bench.verdict.outside import kept_scan_outside, noise_of, water_of
from bench.verdict.parts import Say
from bench.verdict.uncertainty import spread
from bench.verdict.worlds import ORDINARY
from hw_sim.optics.view import TrueView
from hw_sim.scene import Scene
from tests.support.moved import FRAME_S, recorded
from tests.support.rendered import RenderedScan
from tests.support.truth import WATER

WORSE = 1.05
"""Times the error without compensation, and a scan was made worse."""
PERIOD_PX = 16
Row = dict[str, Any]
Rows = Sequence[Row]


def measure(
    scans: int, seed: int, say: Say, keep: Path | None = None, world: str = ORDINARY
) -> tuple[list[Measurement], dict[str, Any]]:
    """Measure the nine named cases, and ``scans`` drawn ones, in ``world``."""
    named, drawn = named_cases(seed), [drawn_case(seed, k) for k in range(scans)]
    rows = judge_cases([*named, *drawn], say, keep, world)
    first = len(named) * len(kinds_in(world))
    return figures(rows[:first], rows[first:]), {"seed": seed, "named": rows[:first], "drawn": rows[first:]}


def kinds_in(world: str) -> tuple[str, ...]:
    """Return the kinds of calibration for a scan: in the world ``outside`` only the one that states the truth."""
    return KINDS if world == ORDINARY else KINDS[:1]


def judge_cases(cases: Sequence[Case], say: Say, keep: Path | None, world: str = ORDINARY) -> list[Row]:
    """Return the rows of all cases, with each kind of calibration."""
    judge, rows = Judge(keep, world), []
    for number, case in enumerate(cases):
        say(case.name, number / len(cases))
        rows += judge.rows(case)
    return rows


class Judge:
    """Judge of scans, which are stored in a folder if one is given; results at rest are kept in memory."""

    def __init__(self, keep: Path | None, world: str = ORDINARY) -> None:
        self._keep, self._world = keep, world
        self._rest: dict[tuple[Scene, int, int, str], CloudErrors] = {}
        self._seen: tuple[RenderedScan, float, TrueView] | None = None

    def rows(self, case: Case) -> list[Row]:
        """Return a row for each kind of calibration."""
        scan = self._scan(case, case.scene)
        return [self._row(case, scan, kind) for kind in kinds_in(self._world)]

    def _scan(self, case: Case, scene: Scene) -> RenderedScan:
        if self._world != ORDINARY:
            hands = not scene.motion.still
            return kept_scan_outside(
                self._keep, scene, case.truth_set, case.seed, case.width_px, PERIOD_PX, hands=hands
            )
        frame_s = 0.0 if scene.motion.still else FRAME_S
        return kept_scan(self._keep, scene, case.truth_set, case.seed, case.width_px, PERIOD_PX, frame_s)

    def _true(self, scan: RenderedScan, rig: StereoRig, time_s: float) -> TrueScene:
        """Return the true scene; the same view serves all kinds of calibration."""
        cached = self._seen
        view = cached[2] if cached is not None and cached[0] is scan and cached[1] == time_s else None
        true = TrueScene(scan, rig, time_s, view, self._water(scan))
        self._seen = (scan, time_s, true.view)
        return true

    def _water(self, scan: RenderedScan) -> Water:
        return WATER if self._world == ORDINARY else water_of(scan.renderer.truth)

    def _noise(self, scan: RenderedScan) -> StereoNoise:
        return TYPICAL_PAIR if self._world == ORDINARY else noise_of(scan.renderer.scene, 0.0)

    def _pipeline(self, scan: RenderedScan, calibration: Calibration) -> Pipeline:
        return Pipeline(calibration, self._water(scan), scan.sequence, noise=self._noise(scan))

    def _at_rest(self, case: Case, kind: str) -> CloudErrors:
        key = (case.rest, case.seed, case.width_px, kind)
        if key not in self._rest:
            scan = self._scan(case, case.rest)
            calibration = calibration_of(kind, scan.renderer.truth)
            with self._pipeline(scan, calibration) as pipeline:
                full = _push(pipeline, scan)
                self._rest[key] = self._true(scan, calibration.rig, 0.0).judge(pipeline.table.cloud(full))
        return self._rest[key]

    def _row(self, case: Case, scan: RenderedScan, kind: str) -> Row:
        at_rest = self._at_rest(case, kind)
        calibration = calibration_of(kind, scan.renderer.truth)
        with self._pipeline(scan, calibration) as pipeline:
            full = _push(pipeline, scan)
            plain = pipeline.table.cloud(full)
            begun_s = time.process_time()
            images = recorded(scan, pipeline, self._noise(scan))
            water = self._water(scan)
            added = judge_motion(images, plain, calibration.rig, water.index).added
            attempted = attempt(pipeline, full, images, calibration, water, added)
            cpu_s = time.process_time() - begun_s
            time_s = attempted.motion.reference_s if attempted.motion is not None else 10.5 * FRAME_S
            true = self._true(scan, calibration.rig, time_s)
            before = true.judge(plain)
            after = before
            if attempted.found is not None:
                after = true.judge(pipeline.table.cloud(attempted.found))
        return {
            "name": case.name, "object": case.scene.object, "texture": case.scene.texture, "calibration": kind,
            "moved": not case.at_rest, "used": attempted.found is not None, "why": attempted.why, "cpu_s": cpu_s,
            "at_rest_mm": at_rest.own_rms_mm, "before": before.own_rms_mm / at_rest.own_rms_mm,
            "after": after.own_rms_mm / at_rest.own_rms_mm,
            "surface_mm": {
                "at_rest": at_rest.accuracy.rms_mm, "before": before.accuracy.rms_mm, "after": after.accuracy.rms_mm,
            },
            "outliers_ppm": {
                "at_rest": at_rest.accuracy.outliers_ppm, "before": before.accuracy.outliers_ppm,
                "after": after.accuracy.outliers_ppm,
            },
            "completeness_at_rest": at_rest.accuracy.completeness_percent,
            "completeness_before": before.accuracy.completeness_percent,
            "completeness_after": after.accuracy.completeness_percent,
            "in_sigmas_at_rest": spread(at_rest.residuals)["rms_trimmed"],
            "in_sigmas": spread(after.residuals)["rms_trimmed"] if attempted.found is not None else None,
            **_expected(attempted),
        }  # fmt: skip


def figures(named: Rows, drawn: Rows) -> list[Measurement]:
    """Return the figures of compensation with their targets."""
    every = [*named, *drawn]
    measured = []
    for kind in KINDS:
        mine = [row for row in named if row["calibration"] == kind]
        if not mine:
            continue
        measured += [
            Measurement(
                f"hand {hand}, {kind} rig: rms over at rest, worst of three", _worst(mine, f"{hand}-", "after"), "",
                at_most=1.2, key=f"compensation_{hand}" if kind == "calibrated" else None,
            )
            for hand in NAMED
        ]  # fmt: skip
    measured += [
        Measurement(f"hand {hand}: the same, nothing done", _worst(named, f"{hand}-", "before"), "") for hand in NAMED
    ]
    used = [row for row in drawn if row["used"]]
    return [
        *measured,
        of("drawn, compensated: rms over at rest, median", used, "after", median, at_most=1.2),
        of("drawn, compensated: the same, nothing done", used, "before", median),
        of("drawn, compensated: worst", used, "after", max),
        Measurement("drawn scans compensated", float(len(used)), f"of {len(drawn)}"),
        Measurement(
            "drawn scans to be repeated", float(sum(row["moved"] and not row["used"] for row in drawn)), "scans"
        ),
        made_worse(every),
        Measurement(
            "named, compensated: error in own sigmas (or its inverse), worst", _farthest(named), "", at_most=1.1
        ),
        of("CPU time of an attempt at 800 x 600, median", named, "cpu_s", median, "s"),
    ]


def made_worse(rows: Rows) -> Measurement:
    """Return the number of scans that compensation made worse; none is allowed."""
    count = sum(map(worse, rows))
    return Measurement("scans made worse", float(count), f"of {len(rows)}", at_most=0.0, key="compensation_worse")


def worse(row: Row) -> bool:
    """Return True if the shown points have larger errors than those without compensation."""
    return bool(row["used"]) and float(row["after"]) > WORSE * float(row["before"])


def _expected(attempted: Attempt) -> dict[str, float | None]:
    """Return the attempt's own expectations."""
    motion = attempted.motion
    return {
        "expected_before": attempted.error_before,
        "expected_after": attempted.error_after,
        "ripple_after": None if motion is None else motion.ripple_after,
        "noise_factor": None if motion is None else motion.noise_factor,
    }


def _push(pipeline: Pipeline, scan: RenderedScan) -> CloudLocation:
    for k in range(len(scan.sequence)):
        for side in SIDES:
            pipeline.push(side, scan.frames[side], k)
    pipeline.find_coarse()
    return pipeline.find_full(straightened=False)


def _worst(rows: Rows, begins: str, what: str) -> float:
    return max(float(row[what]) for row in rows if row["name"].startswith(begins))


def _farthest(rows: Rows) -> float:
    ratios = [float(row["in_sigmas"]) for row in rows if row["in_sigmas"] is not None]
    return max((max(ratio, 1.0 / ratio) for ratio in ratios), default=math.nan)


def of(
    name: str,
    rows: Rows,
    what: str,
    how: Callable[[Iterable[float]], float],
    unit: str = "",
    at_most: float | None = None,
) -> Measurement:
    """Return a figure of all rows; NaN without rows."""
    if not rows:
        return Measurement(name, math.nan, unit, why="there was none")
    return Measurement(name, float(how([float(row[what]) for row in rows])), unit, at_most=at_most)


def median(values: Iterable[float]) -> float:
    """Return the median of numbers."""
    return float(np.median(list(values)))
