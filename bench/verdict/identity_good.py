"""False alarms of the check of frame identity on good scans, and its judgement of very fast motion.

The scenes are those of the verdict on motion: at rest and moving, dark, textured, turbid, in flicker, with specks and
fish. A third of them is also recorded in milky water, and a quarter with hands too fast for any scan. All frames are in
the right order, so such a scan may be rejected for its motion, never for its patterns.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from appliance.measure.light.patterns import build_sequence
from appliance.measure.verdicts.identity.judge import judge_identity
from bench.result import Measurement
from bench.verdict.binomial import rate, tally
from bench.verdict.kept_scans import Scans, Take
from bench.verdict.motion import case_of
from bench.verdict.motion_cases import Case
from bench.verdict.parts import Say
from bench.verdict.worlds import ORDINARY, scans_of
from hw_sim.objects.motion import Motion
from hw_sim.water.medium import Water

MILK_EVERY, FAST_EVERY = 3, 4
FAST_MM_S = (60.0, 250.0)
SLOW_MM_S = 30.0
"""Largest speed of a deliberate scan."""


@dataclass(frozen=True, slots=True)
class Row:
    """One good scan."""

    kind: str
    """``rest``, ``moving``, ``milk`` or ``fast``."""
    seed: int
    what: str
    classes: tuple[str, ...]
    speed_mm_s: float
    passed: bool | None
    doubt: float | None
    cpu_ms: float
    text: str


def measure(
    scans: int, seed: int, say: Say, keep: Path | None = None, world: str = ORDINARY
) -> tuple[list[Measurement], dict[str, Any]]:
    """Measure ``scans`` scenes of ``world``, each at rest and moving, and some of them otherwise.

    Their frames come from ``keep``.
    """
    scan_source = scans_of(world, keep)
    rows: list[Row] = []
    for number in range(scans):
        say(f"identity: scene {number + 1} of {scans}", number / scans)
        for kind, case, take in takes(seed, number):
            rows.append(_judged(kind, case, take, scan_source))
    return _figures(rows), {"scans": [_as_row(row) for row in rows]}


def takes(seed: int, number: int) -> Iterator[tuple[str, Case, Take]]:
    """Yield the recordings of scene ``number``."""
    case = case_of(seed, number)
    yield "rest", case, Take.REST
    yield "moving", case, Take.MOVING
    rng = np.random.default_rng([seed, number, 2027])
    if number % MILK_EVERY == 0:
        milk = Water(float(rng.uniform(1.0, 3.5)), float(rng.uniform(0.2, 0.9)), float(rng.uniform(0.1, 0.8)))
        yield "milk", replace(case, scene=replace(case.scene, water=milk)), Take.REST
    if number % FAST_EVERY == 0:
        direction = rng.standard_normal(3)
        speed = float(rng.uniform(*FAST_MM_S))
        x, y, z = (speed * direction / np.linalg.norm(direction)).tolist()
        yield "fast", replace(case, motion=Motion((x, y, z)), speed_mm_s=speed), Take.MOVING


def _judged(kind: str, case: Case, take: Take, scan_source: Scans) -> Row:
    frames, noise = scan_source.recorded(case, take, 1).noisy, scan_source.noise(case)
    begun = time.process_time()
    verdict = judge_identity(frames, build_sequence(case.period_px), noise).verdict
    cpu_ms = 1e3 * (time.process_time() - begun)
    speed = case.speed_mm_s if take is Take.MOVING else 0.0
    return Row(
        kind, case.seed, case.scene.object, case.classes, speed, verdict.passed, verdict.numbers["doubt"], cpu_ms, verdict.text
    )  # fmt: skip


def _figures(rows: Sequence[Row]) -> list[Measurement]:
    measured: list[Measurement] = []
    for kind in ("rest", "moving", "milk", "fast"):
        mine = [row for row in rows if row.kind == kind]
        if not mine:
            continue
        alarms = sum(row.passed is False for row in mine)
        name = f"identity: {len(mine)} good scans, {kind}"
        measured += [
            tally(f"{name}: called wrong", alarms, len(mine), at_most=0.0, key=f"identity_good_{kind}_alarms"),
            rate(f"{name}: judged", sum(row.passed is not None for row in mine), len(mine)),
            Measurement(f"{name}: largest doubt of those that pass", _largest(mine), ""),
        ]
    for name in sorted({name for row in rows for name in row.classes}):
        mine = [row for row in rows if name in row.classes and row.speed_mm_s <= SLOW_MM_S and row.kind != "milk"]
        measured.append(Measurement(f"identity: up to {SLOW_MM_S:.0f} mm/s, {name}, largest doubt", _largest(mine), ""))
    cpu = [row.cpu_ms for row in rows if row.kind == "rest"]
    measured.append(Measurement("identity: CPU of a good scan, median", float(np.median(cpu)), "ms", at_most=20.0))
    return measured


def _largest(rows: Sequence[Row]) -> float:
    return max((row.doubt for row in rows if row.doubt is not None and row.passed), default=float("nan"))


def _as_row(row: Row) -> dict[str, Any]:
    return {
        "kind": row.kind,
        "seed": row.seed,
        "object": row.what,
        "classes": list(row.classes),
        "speed_mm_s": round(row.speed_mm_s, 2),
        "passed": row.passed,
        "doubt": None if row.doubt is None else round(row.doubt, 4),
        "text": row.text,
    }
