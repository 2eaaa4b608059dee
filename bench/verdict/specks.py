"""Effect of snow, bubbles and fish before an object at rest: wrong points that stay, and true ones that are lost.

Each scene is scanned twice by the same hidden rig, with and without what drifts before it. A point is wrong when it is farther
from the true surface than a millimetre and five of its expected errors. Points of the scan without drift that are missing with
it are lost: mostly since something did pass before them, in one camera or the other, while fringes were recorded. Pixels that
lose their coordinates although no frame shows anything before them are told apart from those.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import Mask
from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.exposure import Exposure
from appliance.measure.points.pipeline import Cloud, Pipeline
from appliance.measure.procedure import SequenceProcessor
from appliance.measure.verdict import Judgement
from bench.result import Measurement
from bench.turbidity.scan import WRONG_MM, WRONG_SIGMAS, rig_in, set_water
from bench.turbidity.scenes import drawn_scene
from bench.verdict.light_scenes import STEPS, noise_at
from bench.verdict.parts import Say
from hw_sim.rendering.render import Renderer
from hw_sim.scene import Scene
from hw_sim.water.drift import Drift
from hw_sim.water.medium import Water
from tests.support.bias import depth_errors
from tests.support.rendered import render_scan
from tests.support.truth import true_calibration

WIDTH_PX, PERIOD_PX = 400, 16
EXPOSURE = Exposure(8_000)
TOUCHED_DN = 4.0
"""Of a frame, against the same frame without drift and with the same noise; two grey values are rounding and photons."""
KINDS = {
    "snow, 50 in a litre": Drift(particles_per_l=50.0),
    "snow, 200 in a litre": Drift(particles_per_l=200.0),
    "40 bubbles": Drift(bubbles=40),
    "150 bubbles": Drift(bubbles=150),
    "a fish": Drift(fish=1),
    "three fish": Drift(fish=3),
}


@dataclass(frozen=True, slots=True)
class ScanResult:
    """One scan, as the diver gets it."""

    frames: NDArray[np.uint8]
    """(n, h, w): the left camera's."""
    cloud: Cloud
    wrong: NDArray[np.bool_]
    """(points,)"""
    decoded: NDArray[np.bool_]
    """(h, w): the left camera's pixels with coordinates."""
    water: Judgement


@dataclass(frozen=True, slots=True)
class DriftCounts:
    """One scene with one kind of drift."""

    kind: str
    what: str
    seed: int
    points: int
    wrong: int
    clear_points: int
    clear_wrong: int
    lost: int
    """Of the points without drift: not in the scan with it."""
    touched: int
    """Pixels of the left camera with coordinates without drift, before which some frame shows it."""
    masked: int
    """Of these, without coordinates with drift."""
    untouched: int
    """The other pixels with coordinates without drift."""
    masked_untouched: int
    """Of these, without coordinates with drift."""
    specks_percent: float
    dirty: bool


def measure(scans: int, seed: int, say: Say) -> tuple[list[Measurement], dict[str, Any]]:
    """Measure ``scans`` scenes, each once without drift and once with every kind of it."""
    rows: list[DriftCounts] = []
    for number in range(scans):
        rng = np.random.default_rng([seed, number, 63])
        scene = replace(drawn_scene(rng, Water()), ambient=0.02)
        rig_seed = 1000 * seed + number
        clear = _take(scene, rig_seed)
        for k, (kind, drift) in enumerate(KINDS.items()):
            say(f"{kind} before {scene.object}", (number + k / len(KINDS)) / scans)
            drifting = _take(replace(scene, drift=replace(drift, seed=rig_seed)), rig_seed)
            rows.append(_count(kind, scene, rig_seed, clear, drifting))
    return [figure for kind in KINDS for figure in _figures(kind, rows)], {"scans": [asdict(row) for row in rows]}


def _take(scene: Scene, rig_seed: int) -> ScanResult:
    """Record, judge and reconstruct a scan as the worker does."""
    scan = render_scan(scene, "modelled", rig_seed, WIDTH_PX, PERIOD_PX, EXPOSURE.time_us / 1e6)
    water = set_water(scene)
    renderer = Renderer(rig_in(water, "modelled", rig_seed, WIDTH_PX), scene)
    calibration = replace(true_calibration(renderer.truth), water=water)
    with Pipeline(calibration, water, scan.sequence) as pipeline:
        processor = SequenceProcessor(pipeline, calibration, water)
        full = processor.process(scan.frames, AcquisitionSettings(EXPOSURE, noise=noise_at(EXPOSURE), steps=STEPS))
        (dirty,) = [judgement for judgement in full.judgements if judgement.verdict.name == "water"]
        cloud = pipeline.table.cloud(full.cloud)
        decoded = pipeline.decoded("left").mask == Mask.VALID
    off = np.abs(np.nan_to_num(depth_errors(renderer, cloud).along_ray_mm, nan=1e3))
    wrong = (off > WRONG_MM) & (off > WRONG_SIGMAS * cloud.sigma_mm)
    return ScanResult(scan.frames["left"], cloud, np.asarray(wrong, np.bool_), decoded, dirty)


def _count(kind: str, scene: Scene, seed: int, clear: ScanResult, drifting: ScanResult) -> DriftCounts:
    difference = np.zeros(clear.decoded.shape, np.int16)
    for before, after in zip(clear.frames, drifting.frames, strict=True):
        np.maximum(difference, np.abs(before.astype(np.int16) - after), out=difference)
    touched = clear.decoded & (difference > TOUCHED_DN)
    untouched = clear.decoded & ~touched
    water = drifting.water
    return DriftCounts(
        kind=kind,
        what=scene.object,
        seed=seed,
        points=drifting.wrong.size,
        wrong=_some(drifting.wrong),
        clear_points=clear.wrong.size,
        clear_wrong=_some(clear.wrong),
        lost=int(np.setdiff1d(clear.cloud.pixel, drifting.cloud.pixel).size),
        touched=_some(touched),
        masked=_some(touched & ~drifting.decoded),
        untouched=_some(untouched),
        masked_untouched=_some(untouched & ~drifting.decoded),
        specks_percent=float(water.verdict.numbers["speck_percent"] or 0.0),
        dirty=water.fault is not None,
    )


def _some(flags: NDArray[np.bool_]) -> int:
    return int(np.count_nonzero(flags))


def _figures(kind: str, rows: list[DriftCounts]) -> list[Measurement]:
    mine = [row for row in rows if row.kind == kind]

    def share(part: str, denominator: str) -> float:
        count, total = (float(sum(getattr(row, name) for row in mine)) for name in (part, denominator))
        return count / max(total, 1.0)

    key = kind.replace(" ", "_").replace(",", "")
    return [
        Measurement(
            f"{kind}: wrong points", 1e6 * share("wrong", "points"), "ppm", at_most=100.0, key=f"{key}_wrong_ppm"
        ),
        Measurement(
            f"{kind}: the same in the worst scene", max(1e6 * row.wrong / max(row.points, 1) for row in mine), "ppm"
        ),
        Measurement(f"{kind}: wrong without it", 1e6 * share("clear_wrong", "clear_points"), "ppm"),
        Measurement(f"{kind}: points lost", 100.0 * share("lost", "clear_points"), "%"),
        Measurement(f"{kind}: pixels that it shows in", 100.0 * _all_touched(mine), "%"),
        Measurement(f"{kind}: of these, masked", 100.0 * share("masked", "touched"), "%"),
        Measurement(
            f"{kind}: of the others, masked", 100.0 * share("masked_untouched", "untouched"), "%", at_most=1.0
        ),
    ]  # fmt: skip


def _all_touched(rows: list[DriftCounts]) -> float:
    return sum(row.touched for row in rows) / max(sum(row.touched + row.untouched for row in rows), 1)
