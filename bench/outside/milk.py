"""The part ``milk``: completeness in water as white as diluted milk."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from bench.outside.draws import joined
from bench.outside.figures import median, rows_of
from bench.outside.kept import Row, kept_row, kept_scan
from bench.outside.noise import WAYS
from bench.outside.scan import SEQUENCE, row_of, worked_through
from bench.outside.stated import stated_truth
from bench.outside.world import world_with
from bench.result import Measurement
from bench.spread import spread
from bench.verdict.parts import Say
from hw_sim.outside import ALL
from hw_sim.scene import Scene
from hw_sim.water.medium import Water

MILK = Water(attenuation_per_m=3.0, backscatter=0.3)
SETS = {
    "none": (),
    "backscatter": ("backscatter",),
    "all at rest": tuple(name for name in ALL if name != "hands"),
}
TARGET = "backscatter"
TARGET_PERCENT = 90.0
OBJECTS = ("plane", "pipe", "frustum", "stones", "shell")
SEEDS_PER_SEED = 1000


def measure(
    count: int, seed: int, say: Say, keep: Path | None = None, noise: str = "sheet"
) -> tuple[list[Measurement], dict[str, Any]]:
    """Return the completeness of ``count`` scans in milk with no family, backscatter alone, and all at rest."""
    jobs = [(name, number) for name in SETS for number in range(count)]
    rows: dict[str, list[Row]] = {name: [] for name in SETS}
    for finished, ((name, _), row) in enumerate(
        zip(jobs, spread(partial(_row, seed=seed, keep=keep, noise=noise), jobs), strict=True), 1
    ):
        say(f"milk: {finished} of {len(jobs)}", finished / len(jobs))
        rows[name].append(row)
    measured = []
    for name, scans in rows.items():
        target = TARGET_PERCENT if name == TARGET else None
        complete = median(rows_of(scans, "complete_percent"))
        measured.append(Measurement(f"completeness in milk, {name}", complete, "%", at_least=target))
        measured.append(
            Measurement(f"error over sigma in milk, {name}", median(rows_of(scans, "error_over_sigma")), "")
        )
    return measured, {"rows": rows}


def _row(job: tuple[str, int], seed: int, keep: Path | None, noise: str) -> Row:
    name, number = job
    return kept_row(keep, ("milk", name, number, seed, noise), lambda: _found(name, number, seed, keep, noise))


def _found(name: str, number: int, seed: int, keep: Path | None, noise: str) -> Row:
    scene_seed = SEEDS_PER_SEED * seed + number
    families = SETS[name]
    scene = Scene(object=OBJECTS[number % len(OBJECTS)], water=MILK)
    world = world_with(scene, joined(scene_seed, scene_seed, families), scene_seed, families)
    scan = kept_scan(keep, world, SEQUENCE)
    stated = stated_truth(world.rig, world.scene)
    noise_known = WAYS[noise](world, scan.exposure.gain_db, keep)
    scanned = worked_through(scan.frames, stated.calibration, stated.water, scan.exposure, noise_known)
    return {"number": number, **row_of(world, scanned, scan.exposure)}
