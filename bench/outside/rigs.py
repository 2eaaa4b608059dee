"""The part ``rigs``: errors of calibrated instruments of the world ``outside``, and whether they are announced.

Each rig has lenses, windows, plates, mounts and an LED of its own. It is calibrated in air in a cool case, then in water in a warm one from
four recordings and from ten, by someone who believes the data sheet's wavelength; bars, planes and frustums that no calibration has
seen judge it. Everything is made point by point: exact optics, and the noise of matching.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from appliance.calibrate.recordings import Recording
from appliance.calibrate.water.calibrate import calibrate
from appliance.calibrate.water.method import Method
from bench.outside.kept import Row, kept_row
from bench.result import Measurement
from bench.spread import spread
from bench.verdict.binomial import tally
from bench.verdict.parts import Say
from hw_sim.in_dive import REFERENCE_C, in_dive
from hw_sim.outside import draw_outside
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, draw_truth, with_flaws, with_glass
from tests.support.calibrating import (
    CALIBRATION_BARS,
    CALIBRATION_PLANES,
    HEIGHT_PX,
    MORE_BARS,
    MORE_PLANES,
    WIDTH_PX,
    air_of,
    calibration_recordings,
    evaluate,
    start_of,
)

OF_THE_RIG = ("lens", "plates", "mounts", "projector")
"""The families that a calibration meets; of the projector, the LED's colour alone."""
SETS: dict[str, tuple[str, ...]] = {"ordinary": (), **{name: (name,) for name in OF_THE_RIG}, "all": OF_THE_RIG}
ALONE = 4
"""One of so many rigs is also measured with each family alone."""
CASE_C, LATER_K = 35.0, 4.0
"""Case temperature during calibration in water, and the rise until another dive."""
RECORDINGS = (4, 10)
FRUSTUMS = 4
LENGTH_PERCENT = {4: 0.05, 10: 0.025}
FLAT_PERCENT = 0.05


@dataclass(frozen=True, slots=True)
class Rig:
    """One true rig as it is calibrated in air, in water, and on a later dive."""

    dry: TrueRig
    wet: TrueRig
    later: TrueRig


def measure(count: int, seed: int, say: Say, keep: Path | None = None) -> tuple[list[Measurement], dict[str, Any]]:
    """Return the errors of ``count`` rigs with all families and with none, and of some with each family alone.

    Their seeds begin with ``seed``. The figures say which errors were announced.
    """
    few = max(1, count // ALONE)
    jobs = [(name, k) for name in SETS for k in range(count if name in {"ordinary", "all"} else few)]
    rows: dict[str, list[Row]] = {name: [] for name in SETS}
    work = partial(_row, seed=seed, keep=keep)
    for finished, ((name, _), row) in enumerate(zip(jobs, spread(work, jobs), strict=True), 1):
        say(f"rigs: {finished} of {len(jobs)}", finished / len(jobs))
        rows[name].append(row)
    return figures(rows), {"rigs": [row for set_rows in rows.values() for row in set_rows]}


def figures(rows: dict[str, list[Row]]) -> list[Measurement]:
    """Return the figures of the rows of each set of families."""
    measured = []
    for name, rigs in rows.items():
        for number in RECORDINGS:
            of_all = [row[str(number)] for row in rigs]
            label = f"{name}, {number} recordings"
            for key, limit in (("E_Lb", LENGTH_PERCENT[number]), ("E_Lp", None), ("E_F_sys", FLAT_PERCENT)):
                measured.append(_worst(f"{label}: {key} of the worst of {len(rigs)}", of_all, key, limit))
                if limit is not None:
                    median = float(np.median([result[key] for result in of_all]))
                    measured.append(Measurement(f"{label}: {key}, median", median, "%"))
            warmer = f"{label}: E_Lb of the worst in a case {LATER_K:g} K warmer"
            measured.append(_worst(warmer, of_all, "E_Lb_later", LENGTH_PERCENT[number]))
    for name in ("ordinary", "all"):
        missed = [result for row in rows[name] for n in RECORDINGS if _misses(result := row[str(n)], n)]
        silent = sum(not result["warnings"] for result in missed)
        warned = sum(bool(row[str(n)]["warnings"]) for row in rows[name] for n in RECORDINGS) - (len(missed) - silent)
        calibrations = len(RECORDINGS) * len(rows[name])
        measured.append(tally(f"{name}: calibrations that miss a target", len(missed), calibrations))
        measured.append(tally(f"{name}: that miss one and do not say so", silent, calibrations, at_most=0.0))
        alarms = 0.0 if name == "ordinary" else None
        measured.append(tally(f"{name}: that keep all and warn", warned, calibrations, at_most=alarms))
    return measured


def _worst(name: str, rigs: Sequence[Row], key: str, limit: float | None) -> Measurement:
    """Return the largest of an error with its ``limit``; it is called *announced*, without a limit, if each rig beyond
    warned."""
    worst = max(rig[key] for rig in rigs)
    missed = [] if limit is None else [rig for rig in rigs if rig[key] > limit]
    if missed and all(rig["warnings"] for rig in missed):
        return Measurement(f"{name}, announced", worst, "%")
    return Measurement(name, worst, "%", at_most=limit)


def drawn(families: Sequence[str], seed: int) -> Rig:
    """Return the rig of a seed with the strengths of ``families``."""
    outside = draw_outside(seed, families)
    scene = Scene(outside=outside)
    rig = with_flaws(draw_truth("realistic", seed, WIDTH_PX, HEIGHT_PX, scene.index), outside)
    rig = with_glass(rig, scene.glass_more)
    if outside.mounts is None:
        return Rig(rig, rig, rig)
    warm_k = CASE_C - REFERENCE_C
    return Rig(rig, in_dive(rig, outside.mounts, warm_k), in_dive(rig, outside.mounts, warm_k + LATER_K))


def recorded(rig: TrueRig, number: int) -> list[Recording]:
    """Return the recordings of that number: two bars and two planes as published, or four and six."""
    if number == RECORDINGS[0]:
        return calibration_recordings(rig)
    return calibration_recordings(rig, (*CALIBRATION_BARS, *MORE_BARS), (*CALIBRATION_PLANES, *MORE_PLANES))


def _misses(row: Row, number: int) -> bool:
    return bool(row["E_Lb"] > LENGTH_PERCENT[number] or row["E_F_sys"] > FLAT_PERCENT)


def _row(job: tuple[str, int], seed: int, keep: Path | None) -> Row:
    name, number = job
    return kept_row(keep, ("rigs", name, number, seed), lambda: _found(name, number, seed))


def _found(name: str, number: int, seed: int) -> Row:
    rig_seed = seed + number
    rig = drawn(SETS[name], rig_seed)
    start = start_of(air_of(rig.dry))
    row: Row = {"families": name, "seed": rig_seed}
    for recordings in RECORDINGS:
        result = calibrate(Method.SPLINE, recorded(rig.wet, recordings), start)
        errors = evaluate(rig.wet, result.calibration.rig, frustums=FRUSTUMS)
        later = evaluate(rig.later, result.calibration.rig, planes=1)
        row[str(recordings)] = {
            "E_Lb": errors.length,
            "E_Lp": errors.frustum,
            "E_F_sys": errors.flatness,
            "E_Lb_later": later.length,
            "expected": None if result.expected is None else result.expected.length_percent,
            "expected_flat": None if result.expected is None else result.expected.flat_percent,
            "residual_px": result.calibration.residual_px,
            "systematic_px": result.systematic_px,
            "warnings": list(result.warnings),
        }
    return row
