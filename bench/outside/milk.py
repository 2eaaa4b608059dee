"""Owns the part ``milk``: how much of an object is found in water that is as white as diluted milk."""

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
from bench.result import Measured
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
) -> tuple[list[Measured], dict[str, Any]]:
    """Return how complete ``count`` scans in milk are with no family, with backscatter alone, and with all at rest."""
    wanted = [(name, number) for name in SETS for number in range(count)]
    rows: dict[str, list[Row]] = {name: [] for name in SETS}
    for done, ((name, _), row) in enumerate(
        zip(wanted, spread(partial(_row, seed=seed, keep=keep, noise=noise), wanted), strict=True), 1
    ):
        say(f"milk: {done} of {len(wanted)}", done / len(wanted))
        rows[name].append(row)
    found = []
    for name, scans in rows.items():
        least = TARGET_PERCENT if name == TARGET else None
        complete = median(rows_of(scans, "complete_percent"))
        found.append(Measured(f"completeness in milk, {name}", complete, "%", at_least=least))
        found.append(Measured(f"error over sigma in milk, {name}", median(rows_of(scans, "error_over_sigma")), ""))
    return found, {"rows": rows}


def _row(wanted: tuple[str, int], seed: int, keep: Path | None, noise: str) -> Row:
    name, number = wanted
    return kept_row(keep, ("milk", name, number, seed, noise), lambda: _found(name, number, seed, keep, noise))


def _found(name: str, number: int, seed: int, keep: Path | None, noise: str) -> Row:
    own = SEEDS_PER_SEED * seed + number
    families = SETS[name]
    scene = Scene(object=OBJECTS[number % len(OBJECTS)], water=MILK)
    world = world_with(scene, joined(own, own, families), own, families)
    taken = kept_scan(keep, world, SEQUENCE)
    stated = stated_truth(world.rig, world.scene)
    known = WAYS[noise](world, taken.exposure.gain_db, keep)
    scanned = worked_through(taken.frames, stated.calibration, stated.water, taken.exposure, known)
    return {"number": number, **row_of(world, scanned, taken.exposure)}
