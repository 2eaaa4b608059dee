"""The part ``scenes``: results of random scenes, with all families together, and with each alone on some of them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from appliance.calibrate.health import LIMIT
from bench.outside.draws import scene_world
from bench.outside.figures import CALIBRATION, of_families, of_scenes
from bench.outside.health import followed
from bench.outside.kept import Row, kept_row, kept_scan
from bench.outside.noise import WAYS
from bench.outside.scan import SEQUENCE, row_of, worked_through
from bench.outside.stated import stated_truth
from bench.result import Measurement
from bench.spread import spread
from bench.verdict.binomial import tally
from bench.verdict.parts import Say
from hw_sim.outside import ALL

FAMILY_SHARE = 0.03
"""Share of the scenes that are also measured with each family alone and with none."""
ORDINARY = "ordinary"
TOGETHER = "all"


def measure(
    count: int, seed: int, say: Say, keep: Path | None = None, noise: str = "sheet"
) -> tuple[list[Measurement], dict[str, Any]]:
    """Return figures of ``count`` scenes with all families, and of a few of them with each family alone.

    ``noise`` is the source of the camera noise (``noise.WAYS``).
    """
    few = family_scenes(count)
    jobs = [(TOGETHER, number) for number in range(count)]
    jobs += [(name, number) for number in range(few) for name in (ORDINARY, *ALL)]
    rows: dict[str, list[Row]] = {name: [] for name in (TOGETHER, ORDINARY, *ALL)}
    for finished, ((name, _), row) in enumerate(
        zip(jobs, spread(partial(_row, seed=seed, keep=keep, noise=noise), jobs), strict=True), 1
    ):
        say(f"scenes: {finished} of {len(jobs)}", finished / len(jobs))
        rows[name].append(row)
    measured = of_scenes(rows[TOGETHER]) + watched(rows[TOGETHER], seed)
    return measured, {"rows": rows, "families": of_families(rows, few)}


def watched(rows: Sequence[Row], seed: int) -> list[Measurement]:
    """Return the judgements of calibration health over the scans of each instrument of ``seed``.

    Every calibration here is exact, and the instrument moves.
    """
    instruments: dict[int, list[Row]] = {}
    for row in rows:
        instruments.setdefault(row["rig_seed"], []).append(row)
    alarmed, doubted, judged, largest = 0, 0, 0, 0.0
    for scans in instruments.values():
        world = scene_world(seed, scans[0]["number"])
        judgements = list(followed(scans, stated_truth(world.rig, world.scene).calibration.rig))
        alarmed += any(judgement.alarm for judgement in judgements)
        doubted += sum(bool(judgement.alarm) for judgement in judgements)
        judged += sum(judgement.point is not None for judgement in judgements)
        largest = max([largest, *(judgement.point.total for judgement in judgements if judgement.point is not None)])
    return [
        tally("instruments whose calibration is doubted", alarmed, len(instruments), at_most=0.0),
        tally(f"false alarms of {CALIBRATION}", doubted, len(rows), at_most=0.0),
        tally("scans that are judged by the watch over the calibration", judged, len(rows)),
        Measurement("largest sum of the watch over the calibration", largest, f"of {LIMIT:g}", at_most=LIMIT),
    ]


def family_scenes(count: int) -> int:
    """Return how many of ``count`` scenes are measured family by family."""
    return max(1, round(FAMILY_SHARE * count))


def _row(job: tuple[str, int], seed: int, keep: Path | None, noise: str) -> Row:
    return scene_row(job[0], job[1], seed, keep, noise)


def scene_row(name: str, number: int, seed: int, keep: Path | None, noise: str = "sheet") -> Row:
    """Return the row of one scene: ``all``, ``ordinary`` or one family."""
    families = ALL if name == TOGETHER else () if name == ORDINARY else (name,)
    return kept_row(keep, ("scenes", name, number, seed, noise), lambda: _found(number, seed, families, keep, noise))


def _found(number: int, seed: int, families: tuple[str, ...], keep: Path | None, noise: str) -> Row:
    world = scene_world(seed, number, families)
    scan = kept_scan(keep, world, SEQUENCE)
    stated = stated_truth(world.rig, world.scene)
    noise_known = WAYS[noise](world, scan.exposure.gain_db, keep)
    scanned = worked_through(scan.frames, stated.calibration, stated.water, scan.exposure, noise_known)
    return {"number": number, **row_of(world, scanned, scan.exposure)}
