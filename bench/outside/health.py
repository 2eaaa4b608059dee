"""The part ``health``: false alarms of calibration health and of the judges of frames, light and windows, and detection
of a knock.

Some instruments, each with its own lens, projector and cameras, scan whatever comes before them with a calibration that
states the truth about them at the temperature of the case that they work at. Scans are at rest, in water up to 2 /m,
some kelvins warmer or colder. In the end the right camera is turned by a fiftieth of a degree, about one axis before
the renderer, and about each axis in the last normal scans: the ray gaps by the amplitudes that the model gives such a
turn, the third gaps by a calibration that is turned.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.health import LIMIT, SCANS_TO_FIND, HealthJudgement, HealthTrend, judge_health
from appliance.calibrate.third_eye import ThirdEye, judge_with_projector
from appliance.measure.calibration.gaps import MODES, TURNS
from appliance.measure.calibration.parameters import RIG_PARAMETERS
from appliance.measure.cloud import PatchGaps
from appliance.measure.light.model import StereoRig
from bench.outside.draws import drawn_scene, joined
from bench.outside.figures import CALIBRATION, false_alarms, median, rows_of
from bench.outside.kept import Row, kept_row, kept_scan
from bench.outside.noise import WAYS
from bench.outside.scan import SEQUENCE, row_of, worked_through
from bench.outside.stated import stated_truth
from bench.outside.world import World, world_with
from bench.result import Measurement
from bench.spread import spread
from bench.verdict.binomial import tally
from bench.verdict.parts import Say
from hw_sim.mount_shift import MountShift, with_mount_shifted
from hw_sim.outside import ALL

FAMILIES = tuple(name for name in ALL if name != "hands")
RIGS = 8
WORKS_AT_C, AROUND_K = 35.0, 4.0
"""Case temperature during calibration, and its largest difference from this while scanning."""
KNOCK_DEG = 0.02
KNOCKED_SCANS = 6
"""At least three of these should be judged: a ball bar covers too little of the image, and turbid water hides too much.
"""
KNOCKS = ("pitch_deg", "yaw_deg", "roll_deg")
"""Of one rig after the other: about x, y, z."""
SEEDS_PER_SEED = 100_000


def measure(
    count: int, seed: int, say: Say, keep: Path | None = None, noise: str = "sheet"
) -> tuple[list[Measurement], dict[str, Any]]:
    """Return false alarms of about ``count`` normal scans, and the number of scans until a knock is detected."""
    each = max(1, -(-count // RIGS))
    jobs = [(rig, number) for rig in range(RIGS) for number in range(each + KNOCKED_SCANS)]
    rows: dict[int, list[Row]] = {rig: [] for rig in range(RIGS)}
    work = partial(_row, seed=seed, normal=each, keep=keep, noise=noise)
    for finished, ((rig, _), row) in enumerate(zip(jobs, spread(work, jobs), strict=True), 1):
        say(f"health: {finished} of {len(jobs)}", finished / len(jobs))
        rows[rig].append(row)
    return figures(rows, each, seed), {"rows": {str(rig): scans for rig, scans in rows.items()}}


def figures(rows: dict[int, list[Row]], each: int, seed: int) -> list[Measurement]:
    """Return the figures of the rows of each rig of ``seed``; the first ``each`` scans are normal."""
    rigs = {rig: _stated(rig, seed) for rig in rows}
    normal = [row for rig_rows in rows.values() for row in rig_rows[:each]]
    alarmed, doubted, judged, largest, late, unsaid = 0, 0, 0, 0.0, [], 0
    for rig, rig_rows in rows.items():
        judgements = list(followed(rig_rows, rigs[rig]))
        judged += sum(judgement.point is not None for judgement in judgements[:each])
        totals = [judgement.point.total for judgement in judgements[:each] if judgement.point is not None]
        largest = max([largest, *totals])
        alarmed += any(judgement.alarm for judgement in judgements[:each])
        doubted += sum(bool(judgement.alarm) for judgement in judgements[:each])
        if not any(judgement.alarm for judgement in judgements[:each]):
            after = [judgement for judgement in judgements[each:] if judgement.point is not None][:SCANS_TO_FIND]
            late.append(any(judgement.alarm for judgement in after))
            unsaid += (
                len(after) == SCANS_TO_FIND and not late[-1] and all(_sees(judgement, rig % 3) for judgement in after)
            )
    measured = [
        tally(f"rigs whose calibration is doubted, with {each} normal scans each", alarmed, len(rows), at_most=0.0),
        tally("normal scans that are judged", judged, len(normal)),
        Measurement("largest sum of a normal scan", largest, f"of {LIMIT:g}", at_most=LIMIT),
        tally(f"knocks of {KNOCK_DEG:g}° found within three judged scans", sum(late), len(late), at_least=float(len(late))),
        tally("knocks missed though each scan says that it would find them", unsaid, len(late), at_most=0.0),
    ]  # fmt: skip
    measured += _turned_figures([(rigs[rig], list(_seen(rig_rows[:each]))) for rig, rig_rows in rows.items()])
    measured += false_alarms(normal)
    measured.append(tally(f"false alarms of {CALIBRATION}", doubted, len(normal), at_most=0.0))
    measured.append(tally("MOVED at rest", sum("MOVED" in row["faults"] for row in normal), len(normal), at_most=0.0))
    measured.append(Measurement("completeness, median", median(rows_of(normal, "complete_percent")), "%"))
    measured.append(Measurement("error over sigma, median", median(rows_of(normal, "error_over_sigma")), ""))
    return measured


def followed(rows: Iterable[Row], rig: StereoRig) -> Iterator[HealthJudgement]:
    """Yield the judgement of the calibration ``rig`` after each of an instrument's scans."""
    trend, eye = HealthTrend(), ThirdEye()
    for number, gaps in enumerate(_seen(rows), 1):
        trend, eye, judgement = judge_with_projector(trend, eye, rig, gaps, f"{number:06d}")
        yield judgement


def _stated(rig: int, seed: int) -> StereoRig:
    _, stated = health_world(rig, 0, seed)
    return stated_truth(stated.rig, stated.scene).calibration.rig


def _seen(rows: Iterable[Row]) -> Iterator[PatchGaps]:
    for row in rows:
        gaps = row["gaps"]
        if gaps is None:
            continue
        # By their names: a product that knows more about a gap has more of them.
        values: dict[str, Any] = {
            name: np.array(value) if isinstance(value, list) else value for name, value in gaps.items()
        }
        values["patch"] = values["patch"].astype(np.intp)
        values["modes"] = values["modes"].reshape(-1, len(MODES))
        if values.get("sample_px") is not None:
            values["sample_px"] = values["sample_px"].reshape(-1, 6)
            values["pattern_size_px"] = tuple(int(px) for px in values["pattern_size_px"])
        yield PatchGaps(**values)


def _turned_figures(instruments: Sequence[tuple[StereoRig, Sequence[PatchGaps]]]) -> list[Measurement]:
    """Return how many turns about each axis are detected, and how many are not although each scan states that it would.

    The last three judged normal scans are evaluated with a calibration that is turned, either way.
    """
    detected, turns, silent = [0, 0, 0], 0, 0
    for rig, scans in instruments:
        judged = [
            gaps
            for gaps in scans
            if gaps.turns_um is not None and judge_health(HealthTrend(), gaps)[1].point is not None
        ]
        if len(judged) <= SCANS_TO_FIND:
            continue
        trend, eye = HealthTrend(), ThirdEye()
        for gaps in judged[:-SCANS_TO_FIND]:
            trend, eye, _ = judge_with_projector(trend, eye, rig, gaps)
        turns += 2
        for axis in range(3):
            for turn_deg in (KNOCK_DEG, -KNOCK_DEG):
                turned = RIG_PARAMETERS.changed(rig, np.radians(turn_deg), RIG_PARAMETERS.names.index(TURNS[axis]))
                trend_after, eye_now, sees = trend, eye, []
                for gaps in judged[-SCANS_TO_FIND:]:
                    moved_um = gaps.gap_um + turn_deg * (gaps.modes @ _turns_um(gaps)[axis])
                    trend_after, eye_now, judgement = judge_with_projector(
                        trend_after, eye_now, turned, replace(gaps, gap_um=moved_um)
                    )
                    sees.append(_sees(judgement, axis))
                detected[axis] += trend_after.alarm is not None
                silent += trend_after.alarm is None and all(sees)
    measured = [
        tally(f"turns of {KNOCK_DEG:g}° about {name}, in the gaps of normal scans, found within three", count, turns)
        for name, count in zip("xyz", detected, strict=True)
    ]
    measured.append(tally("of these not found though each scan says it would be", silent, 3 * turns))
    return measured


def _sees(judgement: HealthJudgement, axis: int) -> bool:
    """Return True if three scans like this one would detect a turn of ``KNOCK_DEG`` about the axis."""
    least_deg = judgement.numbers.get(f"found_{'xyz'[axis]}_deg")
    return least_deg is not None and least_deg <= KNOCK_DEG


def _turns_um(gaps: PatchGaps) -> NDArray[np.float64]:
    if gaps.turns_um is None:
        raise ValueError("the amplitudes of turns are not known; allowed: gaps of a sampler")
    return gaps.turns_um


def _row(job: tuple[int, int], seed: int, normal: int, keep: Path | None, noise: str) -> Row:
    rig, number = job
    # Scans of the knocked instrument are numbered from a thousand on, so that more normal ones leave them as they are.
    scan_number = number if number < normal else 1000 + number - normal
    return kept_row(
        keep, ("health", rig, scan_number, seed, noise), lambda: _found(rig, scan_number, seed, keep, noise)
    )


def health_world(rig: int, number: int, seed: int) -> tuple[World, World]:
    """Return scan ``number`` of an instrument, and the same instrument as its calibration states it; from 1000 on it is knocked."""
    rig_seed = SEEDS_PER_SEED * seed + rig
    own_seed = SEEDS_PER_SEED * seed + 1000 * (rig + 1) + number
    families = joined(rig_seed, own_seed, FAMILIES)
    scene = drawn_scene(own_seed, number)
    warm_c = WORKS_AT_C + AROUND_K * float(np.random.default_rng([own_seed, 32]).uniform(-1.0, 1.0))
    stated = world_with(scene, families, own_seed, FAMILIES, rig_seed=rig_seed, case_c=WORKS_AT_C)
    now = world_with(scene, families, own_seed, FAMILIES, rig_seed=rig_seed, case_c=warm_c)
    if number >= 1000:
        now = replace(now, rig=with_mount_shifted(now.rig, MountShift("right", **{KNOCKS[rig % 3]: KNOCK_DEG})))
    return now, stated


def _found(rig: int, number: int, seed: int, keep: Path | None, noise: str) -> Row:
    world, before = health_world(rig, number, seed)
    scan = kept_scan(keep, world, SEQUENCE, number=number)
    stated = stated_truth(before.rig, before.scene)
    noise_known = WAYS[noise](world, scan.exposure.gain_db, keep)
    scanned = worked_through(scan.frames, stated.calibration, stated.water, scan.exposure, noise_known)
    return {"number": number, "rig": rig, **row_of(world, scanned, scan.exposure)}
