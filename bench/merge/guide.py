"""Accuracy of the overlap predicted while aiming: live images by hand along the water main, against the truth."""

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
from bench.result import Measurement
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
    """One stored scan, and the poses of the main in the live images after it."""

    texture: str
    scan_pose: Pose
    live: tuple[Pose, ...]
    number: int
    size_px: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Row:
    """Result of one live image."""

    texture: str
    along_mm: float
    true_share: float
    guidance: Guidance | None
    cpu_s: float


def measure(seed: int, size_px: tuple[int, int]) -> tuple[list[Measurement], list[dict[str, Any]]]:
    """Return figures of all live images, and the rows of a table."""
    places = drawn(seed, size_px)
    progress = Progress(len(places))
    rows: list[Row] = []
    for new_rows in spread(live_rows, places):
        progress.step(f"{len(rows)} live pictures")
        rows += new_rows
    figures: list[Measurement] = []
    for texture in PAINTS:
        mine = [row for row in rows if row.texture == texture]
        with_share = [row for row in mine if row.guidance is not None and row.guidance.expected.share]
        lost = [row for row in mine if row.guidance is not None and not row.guidance.expected.share]
        off = [
            abs((row.guidance.expected.share or 0.0) - row.true_share) for row in with_share if row.guidance is not None
        ]
        prefix = f"{texture}: "
        figures.append(Measurement(f"{prefix}live pictures", len(mine), ""))
        figures.append(Measurement(f"{prefix}told a percentage", len(with_share), ""))
        figures.append(Measurement(f"{prefix}told to be lost", len(lost), ""))
        if off:
            figures.append(Measurement(f"{prefix}error of the percentage, median", 100.0 * float(np.median(off)), "%"))
            figures.append(
                Measurement(f"{prefix}error of the percentage, largest", 100.0 * max(off), "%", at_most=10.0)
            )
        false = sum(error > FALSE_SHARE for error in off) + sum(row.true_share > 0.25 for row in lost)
        figures.append(Measurement(f"{prefix}false statements", false, "", at_most=0))
        ways = [
            row
            for row in with_share
            if row.guidance is not None and row.guidance.toward is not None and row.guidance.move is not Move.SCAN_NOW
        ]
        figures.append(
            Measurement(
                f"{prefix}arrows that lead to less or too much",
                sum(_leads_wrong(row) for row in ways),
                f"of {len(ways)}",
            )
        )
        figures.append(
            Measurement(f"{prefix}CPU of a picture, median", float(np.median([row.cpu_s for row in mine])), "s")
        )
        figures.append(
            Measurement(f"{prefix}CPU of a picture, largest", max(row.cpu_s for row in mine), "s", at_most=0.5)
        )
    return figures, [_table_row(row) for row in rows]


def _leads_wrong(row: Row) -> bool:
    """Return True if the guidance leads away from the new part. The water main lies across the picture."""
    if row.guidance is None or row.guidance.toward is None:
        return False
    # The object moved by +along: the kept scan is to the right of the picture's middle, and more of what is new to the left.
    back = np.sign(row.along_mm)
    return (
        bool(np.sign(row.guidance.toward[0]) != (back if row.guidance.move is Move.GO_BACK else -back))
        and row.along_mm != 0.0
    )


def _table_row(row: Row) -> dict[str, Any]:
    guidance = row.guidance
    return {
        "texture": row.texture,
        "along_mm": row.along_mm,
        "true": round(row.true_share, 3),
        "said": None if guidance is None else round(guidance.expected.share or 0.0, 3),
        "move": None if guidance is None else guidance.move.value,
        "toward": None
        if guidance is None or guidance.toward is None
        else [round(value, 2) for value in guidance.toward],
        "cpu_s": round(row.cpu_s, 3),
    }


def drawn(seed: int, size_px: tuple[int, int]) -> list[Place]:
    """Return the places, with the same hands for both paints."""
    places = []
    for texture in PAINTS:
        rng = np.random.default_rng(seed)
        for number, x in enumerate(KEPT_AT_MM):
            sign = -1.0 if number % 2 else 1.0
            live = tuple(held_pose(rng, x + sign * along) for along in ALONG_MM)
            places.append(Place(texture, held_pose(rng, x), live, number, size_px))
    return places


def held_pose(rng: np.random.Generator, x_mm: float) -> Pose:
    """Return the main's pose before a hand-held instrument at ``x_mm`` of it."""
    turned = rng.normal(size=3) * 4.0
    R, _ = pose_matrix((0.0, 0.0, 0.0, *map(float, turned)))
    position_mm = (
        np.array([0.0, 0.0, DISTANCE_MM]) + rng.normal(size=3) * (6.0, 6.0, 15.0) + R @ np.array([x_mm, 0.0, 0.0])
    )
    a, b, c = map(float, position_mm)
    d, e, f = map(float, turned)
    return a, b, c, d, e, f


def live_rows(place: Place) -> list[Row]:
    """Take the stored scan and the live images of one place, and evaluate them by the worker's own code."""
    coarse, points_of_kept, sight = kept_scan(place)
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
        # Two images, as while aiming, because no overlap is reported only after two.
        for picture in pictures:
            small = reduced(picture)
            begun_s = time.process_time()
            *_, guidance = guide.look(coarse, small)
            cpu_s = time.process_time() - begun_s
        view = renderer.view("left", 0.0)
        points = _in_the_object(view.points_rig_mm[view.seen_by_all], pose)[::7]
        distance, _ = of_kept.query(points, distance_upper_bound=SURFACE_MM)
        along = float(place.live[number][0] - place.scan_pose[0])
        rows.append(Row(place.texture, along, float(np.isfinite(distance).mean()), guidance, cpu_s))
    return rows


def kept_scan(place: Place) -> tuple[CoarseView, Array, Sight]:
    """Take the scan at ``place.scan_pose``.

    Return the worker's view of it, its points (n, 3) in the object's frame, and the sight of the guide.
    """
    scene = Scene(object="main", pose=place.scan_pose, texture=place.texture, ambient=AMBIENT)
    world = world_of(scene, 1, (), truth_set="realistic", size_px=place.size_px)
    stated = stated_truth(world.rig, scene)
    frames = expose(world.renderer(), SEQUENCE, EXPOSURE, number=place.number)
    projection = projection_of(stated.calibration.rig.left, stated.water.index)
    with Pipeline(stated.calibration, stated.water, SEQUENCE, noise=data_sheet(scene, 0.0)) as pipeline:
        for side, stack in frames.items():
            for k in range(len(stack)):
                pipeline.push(side, stack, k)
        coarse = pipeline.coarse()
        sine_frames = frames["left"][list(SEQUENCE.axis(Direction.X).sine)]
        view = coarse_view(coarse, pipeline.coarse_stride, frames["left"][SEQUENCE.bright], sine_frames, projection)
        points = pipeline.full().points_mm.copy()
    of_kept = _in_the_object(left_to_rig(world.rig, points), place.scan_pose)
    rig = stated.calibration.rig
    return view, of_kept, Sight(rig.left, stated.water.index, projection, projection_of(rig.right, stated.water.index))


def _in_the_object(points_mm: Array, pose: Pose) -> Array:
    R, t = pose_matrix(pose)
    return np.asarray((points_mm - t) @ R)
