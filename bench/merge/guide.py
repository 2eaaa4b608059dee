"""Owns how well the overlap of a scan that is not taken yet is told while aiming: live pictures by hand along the water main, against the truth."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from appliance.cli.simrig import default_sim_rig
from appliance.instrument.service.settings import live_light_of
from appliance.instrument.worker.memory import reduced
from appliance.measure.guidance import Guidance, Move
from appliance.measure.light.patterns import Direction
from appliance.measure.overlap.next_view import Guide, Sight
from appliance.measure.overlap.overlap import CoarseView, coarse_view
from appliance.measure.overlap.patches import projection_of
from appliance.measure.points.pipeline import Pipeline
from appliance.store.config import load_rig
from bench.merge.views import EXPOSURE, Array
from bench.outside.scan import SEQUENCE, data_sheet
from bench.outside.stated import stated_truth
from bench.outside.world import FRAME_S, expose, world_of
from bench.progress import Progress
from bench.result import Measured
from bench.spread import spread
from hw_sim.objects.motion import pose_matrix
from hw_sim.rendering.render import LightSlice
from hw_sim.scene import Scene
from tests.support.truth import left_to_rig

KEPT_AT_MM = (-250.0, 0.0, 220.0)
ALONG_MM = (0.0, 25.0, 45.0, 65.0, 85.0, 105.0, 125.0, 145.0, 165.0, 190.0, 260.0, 340.0)
"""From the kept scan to the live view, forth from one place and back from the next."""
DISTANCE_MM = 550.0
AMBIENT = 0.01
SURFACE_MM = 3.0
PAINTS = ("slight", "none")
FALSE_SHARE = 0.1
"""A percentage farther off is false."""
Pose = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class Place:
    """One kept scan, and the poses of the main before which live pictures are taken then."""

    texture: str
    kept: Pose
    live: tuple[Pose, ...]
    number: int
    size_px: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Row:
    """One live picture."""

    texture: str
    along_mm: float
    true_share: float
    told: Guidance | None
    cpu_s: float


def measure(seed: int, size_px: tuple[int, int]) -> tuple[list[Measured], list[dict[str, Any]]]:
    """Return figures of all live pictures, and the rows of a table."""
    places = drawn(seed, size_px)
    progress = Progress(len(places))
    rows: list[Row] = []
    for found in spread(looked, places):
        progress.step(f"{len(rows)} live pictures")
        rows += found
    figures: list[Measured] = []
    for texture in PAINTS:
        mine = [row for row in rows if row.texture == texture]
        told = [row for row in mine if row.told is not None and row.told.expected.share]
        lost = [row for row in mine if row.told is not None and not row.told.expected.share]
        off = [abs((row.told.expected.share or 0.0) - row.true_share) for row in told if row.told is not None]
        said = f"{texture}: "
        figures.append(Measured(f"{said}live pictures", len(mine), ""))
        figures.append(Measured(f"{said}told a percentage", len(told), ""))
        figures.append(Measured(f"{said}told to be lost", len(lost), ""))
        if off:
            figures.append(Measured(f"{said}error of the percentage, median", 100.0 * float(np.median(off)), "%"))
            figures.append(Measured(f"{said}error of the percentage, largest", 100.0 * max(off), "%", at_most=10.0))
        false = sum(error > FALSE_SHARE for error in off) + sum(row.true_share > 0.25 for row in lost)
        figures.append(Measured(f"{said}false statements", false, "", at_most=0))
        ways = [
            row
            for row in told
            if row.told is not None and row.told.toward is not None and row.told.move is not Move.SCAN_NOW
        ]
        figures.append(
            Measured(
                f"{said}arrows that lead to less or too much", sum(_leads_wrong(row) for row in ways), f"of {len(ways)}"
            )
        )
        figures.append(Measured(f"{said}CPU of a picture, median", float(np.median([row.cpu_s for row in mine])), "s"))
        figures.append(Measured(f"{said}CPU of a picture, largest", max(row.cpu_s for row in mine), "s", at_most=0.5))
    return figures, [_table_row(row) for row in rows]


def _leads_wrong(row: Row) -> bool:
    """The main lies across the picture: to its left is where it is moved to the right from."""
    if row.told is None or row.told.toward is None:
        return False
    # The object moved by +along: the kept scan is to the right of the picture's middle, and more of what is new to the left.
    back = np.sign(row.along_mm)
    return (
        bool(np.sign(row.told.toward[0]) != (back if row.told.move is Move.GO_BACK else -back)) and row.along_mm != 0.0
    )


def _table_row(row: Row) -> dict[str, Any]:
    told = row.told
    return {
        "texture": row.texture,
        "along_mm": row.along_mm,
        "true": round(row.true_share, 3),
        "said": None if told is None else round(told.expected.share or 0.0, 3),
        "move": None if told is None else told.move.value,
        "toward": None if told is None or told.toward is None else [round(value, 2) for value in told.toward],
        "cpu_s": round(row.cpu_s, 3),
    }


def drawn(seed: int, size_px: tuple[int, int]) -> list[Place]:
    """Return the places, with the same hands for both paints."""
    places = []
    for texture in PAINTS:
        rng = np.random.default_rng(seed)
        for number, x in enumerate(KEPT_AT_MM):
            sign = -1.0 if number % 2 else 1.0
            live = tuple(held(rng, x + sign * along) for along in ALONG_MM)
            places.append(Place(texture, held(rng, x), live, number, size_px))
    return places


def held(rng: np.random.Generator, x_mm: float) -> Pose:
    """Return the main's pose as hands hold the instrument before ``x_mm`` of it."""
    turned = rng.normal(size=3) * 4.0
    R, _ = pose_matrix((0.0, 0.0, 0.0, *map(float, turned)))
    at = np.array([0.0, 0.0, DISTANCE_MM]) + rng.normal(size=3) * (6.0, 6.0, 15.0) + R @ np.array([x_mm, 0.0, 0.0])
    a, b, c = map(float, at)
    d, e, f = map(float, turned)
    return a, b, c, d, e, f


def looked(place: Place) -> list[Row]:
    """Take the kept scan and the live pictures of one place, and let the worker's own code say what it knows."""
    kept, points_of_kept, sight = kept_scan(place)
    of_kept = cKDTree(points_of_kept)
    guide = Guide(sight)
    light = live_light_of(load_rig(default_sim_rig()))
    rows = []
    for number, pose in enumerate(place.live):
        scene = Scene(object="main", pose=pose, texture=place.texture, ambient=AMBIENT)
        renderer = world_of(scene, 1, (), truth_set="realistic", size_px=place.size_px).renderer()
        exposure_s = EXPOSURE.time_us / 1e6
        pictures = [
            renderer.expose(
                "left",
                [LightSlice(light, exposure_s)],
                k * FRAME_S,
                exposure_s,
                0.0,
                (False, False),
                7_000 * number + k,
            )
            for k in range(2)
        ]
        # Twice, as while aiming: that nothing is in common is said of what two pictures show.
        for picture in pictures:
            small = reduced(picture)
            begun_s = time.process_time()
            *_, told = guide.look(kept, small)
            cpu_s = time.process_time() - begun_s
        view = renderer.view("left", 0.0)
        points = _in_the_object(view.points_rig_mm[view.seen_by_all], pose)[::7]
        distance, _ = of_kept.query(points, distance_upper_bound=SURFACE_MM)
        along = float(place.live[number][0] - place.kept[0])
        rows.append(Row(place.texture, along, float(np.isfinite(distance).mean()), told, cpu_s))
    return rows


def kept_scan(place: Place) -> tuple[CoarseView, Array, Sight]:
    """Take the scan at ``place.kept``; return what the worker keeps of it, its points (n, 3) in the object's frame, and what the guide sees by."""
    scene = Scene(object="main", pose=place.kept, texture=place.texture, ambient=AMBIENT)
    world = world_of(scene, 1, (), truth_set="realistic", size_px=place.size_px)
    stated = stated_truth(world.rig, scene)
    frames = expose(world.renderer(), SEQUENCE, EXPOSURE, number=place.number)
    projection = projection_of(stated.calibration.rig.left, stated.water.index)
    with Pipeline(stated.calibration, stated.water, SEQUENCE, noise=data_sheet(scene, 0.0)) as pipeline:
        for side, stack in frames.items():
            for k in range(len(stack)):
                pipeline.push(side, stack, k)
        coarse = pipeline.coarse()
        others = frames["left"][list(SEQUENCE.axis(Direction.X).sine)]
        kept = coarse_view(coarse, pipeline.coarse_stride, frames["left"][SEQUENCE.bright], others, projection)
        points = pipeline.full().points_mm.copy()
    of_kept = _in_the_object(left_to_rig(world.rig, points), place.kept)
    rig = stated.calibration.rig
    return kept, of_kept, Sight(rig.left, stated.water.index, projection, projection_of(rig.right, stated.water.index))


def _in_the_object(points_mm: Array, pose: Pose) -> Array:
    R, t = pose_matrix(pose)
    return np.asarray((points_mm - t) @ R)
