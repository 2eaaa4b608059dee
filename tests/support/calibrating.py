"""Calibration objects before a hidden rig, point by point: exact optics of the simulator, noise of the matching."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.air.calibrate import AirCalibration, calibrate_air
from appliance.calibrate.air.linearised import BoardView
from appliance.calibrate.recordings import ArtefactKind, Recording
from appliance.calibrate.water.artefact import fit_plane, fit_sphere, triangulate
from appliance.calibrate.water.start import start_from_air
from appliance.measure.accept.frustum import EDGE_MM, Face, Frustum
from appliance.measure.accept.plane import Plane, orthogonal_plane
from appliance.measure.accept.points import FitPoints
from appliance.measure.calibration.design import Design, design_calibration
from appliance.measure.calibration.file import Calibration
from appliance.measure.light.model import StereoRig
from appliance.measure.light.water import Water
from hw_sim.objects.shapes import (
    BALL_DISTANCE_MM,
    BALL_RADIUS_MM,
    BOARD_BOW,
    BOARD_FORM,
    BOARD_HALF_X_MM,
    FRUSTUM_BASE_MM,
    FRUSTUM_HEIGHT_MM,
    FRUSTUM_PLATE_X_MM,
    FRUSTUM_PLATE_Y_MM,
    FRUSTUM_TOP_MM,
    PLANE_BOW,
    PLANE_FORM,
    PLANE_HALF_X_MM,
    PLANE_HALF_Y_MM,
    SIZES_OUTSIDE,
    rise,
)
from hw_sim.truth import TrueRig, draw_truth, in_air, project, ray
from tests.support.truth import WATER

Array = NDArray[np.float64]
Labels = NDArray[np.intp]

DESIGN = Design(11.5, 4.5, 230.0, 12.41, 30.0, 5.0, 1.77)
SMALL = replace(DESIGN, pixel_um=18.0)
"""The same with a quarter of the pixels each way."""
NOISE_PX = 0.04
CORNER_NOISE_PX = 0.03
WIDTH_PX, HEIGHT_PX = 1600, 1200
FRUSTUM_POINTS = 20_000
"""A scan has twenty times as many; their noise is the same."""
MEASURING_FIELD_MM = 250.0
"""d_r of the flatness deviation."""


@dataclass(frozen=True)
class Pose:
    """Where an object is in the rig frame: position in mm, then turns about x, y, z in degrees."""

    at_mm: tuple[float, float, float]
    turns_deg: tuple[float, float, float]

    @property
    def rotation(self) -> Array:
        R = np.eye(3)
        for axis, angle in enumerate(np.radians(self.turns_deg)):
            c, s = np.cos(angle), np.sin(angle)
            i, j = [(1, 2), (2, 0), (0, 1)][axis]
            turn = np.eye(3)
            turn[i, i] = turn[j, j] = c
            turn[i, j], turn[j, i] = -s, s
            R = turn @ R
        return R


CALIBRATION_BARS = (Pose((-15.0, -20.0, 505.0), (0.0, 35.0, 20.0)), Pose((15.0, 20.0, 540.0), (0.0, -35.0, 70.0)))
CALIBRATION_PLANES = (Pose((0.0, 0.0, 478.0), (8.0, -10.0, 0.0)), Pose((0.0, 0.0, 570.0), (-10.0, 8.0, 0.0)))
"""The four recordings of the published procedure."""
MORE_BARS = (Pose((10.0, -15.0, 560.0), (0.0, 20.0, -25.0)), Pose((-10.0, 15.0, 490.0), (0.0, -20.0, -70.0)))
MORE_PLANES = (
    Pose((0.0, 0.0, 500.0), (-15.0, 0.0, 0.0)),
    Pose((0.0, 0.0, 524.0), (0.0, 18.0, 0.0)),
    Pose((0.0, 0.0, 524.0), (15.0, -15.0, 0.0)),
    Pose((0.0, 0.0, 550.0), (0.0, -18.0, 0.0)),
)
"""Six more, for what four cannot tell."""


def hidden_rig(truth_set: str, seed: int) -> TrueRig:
    return draw_truth(truth_set, seed, WIDTH_PX, HEIGHT_PX, WATER.index)


def board_views(truth: TrueRig, count: int = 20, seed: int = 1) -> list[BoardView]:
    """A board of 14 × 11 corners, 18 mm apart, before the instrument, in air."""
    rng = np.random.default_rng([seed, truth.seed])
    dry = in_air(truth)
    x, y = np.meshgrid((np.arange(14) - 6.5) * 18.0, (np.arange(11) - 5.0) * 18.0)
    corners = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], -1)
    # As its plate is bent; in air it is the whole board that is wrong, not a noise of its corners.
    board = corners * truth.artefacts.board_scale
    board[:, 2] = _rise(truth, BOARD_BOW, BOARD_FORM, BOARD_HALF_X_MM, board[:, :2])
    views = []
    for k in range(count):
        pose = Pose(
            (float(rng.uniform(-40, 40)), float(rng.uniform(-30, 30)), float(rng.uniform(470, 640))),
            (float(rng.uniform(-30, 30)), float(rng.uniform(-30, 30)), float(rng.uniform(-180, 180))),
        )
        points = board @ pose.rotation.T + pose.at_mm
        seen = {side: project(dry, side, points) for side in ("left", "right")}
        keep = inside(seen["left"]) & inside(seen["right"])
        noisy = {side: uv[keep] + rng.normal(0, CORNER_NOISE_PX, (keep.sum(), 2)) for side, uv in seen.items()}
        views.append(BoardView(f"board {k}", corners[keep], noisy["left"], noisy["right"]))
    return views


def _rise(truth: TrueRig, bow: int, form: int, half_x_mm: float, xy_mm: Array) -> Array:
    """The heights (n,) of a plate's front, as the truth's workshop bent it."""
    sizes = np.zeros(SIZES_OUTSIDE)
    known = truth.artefacts.sizes()
    sizes[: len(known)] = known
    return np.array([rise(sizes, bow, form, half_x_mm, float(x), float(y)) for x, y in xy_mm])


def air_of(truth: TrueRig) -> AirCalibration:
    return calibrate_air(board_views(truth), WIDTH_PX, HEIGHT_PX)


def start_of(air: AirCalibration) -> Calibration:
    """What is known before any recording in water: lenses and pose from air, ports from the drawing."""
    return start_from_air(air, design_calibration(DESIGN, "KF-0001", WIDTH_PX, HEIGHT_PX, WATER))


def inside(uv: Array, width_px: int = WIDTH_PX) -> NDArray[np.bool_]:
    """Which pixels (n, 2) lie in images of that width, 4 to 3."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.all((uv >= 0) & (uv <= [width_px - 1, 0.75 * width_px - 1]), axis=1))


def record_bar(
    truth: TrueRig, pose: Pose, name: str, points: int, noise_px: float, seed: int, water: Water = WATER
) -> Recording:
    """A ball bar along the pose's x axis; ``points`` per sphere at most."""
    rng = np.random.default_rng([seed, truth.seed, 3])
    half = 0.5 * truth.artefacts.ball_distance_mm
    pairs = []
    for sphere, x in enumerate((-half, half)):
        centre = pose.rotation @ [x, 0.0, 0.0] + pose.at_mm
        middle = project(truth, "left", centre)[0]
        size = 1.2 * BALL_RADIUS_MM / 0.16 * truth.left.width_px / WIDTH_PX
        uv = np.round(middle + rng.uniform(-size, size, (3 * points, 2)))
        origin, direction = ray(truth, "left", uv)
        w = origin - centre
        b = np.sum(w * direction, 1)
        inner = b * b - np.sum(w * w, 1) + BALL_RADIUS_MM**2
        hit = inner > 0
        surface = origin - (b + np.sqrt(np.where(hit, inner, 0.0)))[:, None] * direction
        outward = (surface - centre) / BALL_RADIUS_MM
        for side in ("left", "right", "projector"):
            sight = np.array(truth.eye(side).t_mm) - surface
            hit &= np.sum(outward * sight, 1) > 0.3 * np.linalg.norm(sight, axis=1)
        left, right = uv[hit], project(truth, "right", surface[hit])
        keep = inside(left, truth.left.width_px) & inside(right, truth.left.width_px)
        left, right = left[keep][:points], right[keep][:points]
        pairs.append((left, right, np.full(len(left), sphere)))
    left, right, label = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    right = right + rng.normal(0.0, 1.0, right.shape) * noise_px
    return Recording(
        name, ArtefactKind.BALL_BAR, left, right, water, label, length_mm=BALL_DISTANCE_MM, radius_mm=BALL_RADIUS_MM
    )


def record_plane(
    truth: TrueRig, pose: Pose, name: str, points: int, noise_px: float, seed: int, water: Water = WATER
) -> Recording:
    """The plane across the pose's z axis, bent as the truth says; about ``points`` points."""
    rng = np.random.default_rng([seed, truth.seed, 4])
    uv = np.round(rng.uniform([0, 0], [truth.left.width_px - 1, truth.left.height_px - 1], (2 * points, 2)))
    origin, direction = ray(truth, "left", uv)
    o = (origin - pose.at_mm) @ pose.rotation
    d = direction @ pose.rotation
    height = np.zeros(len(uv))
    for _ in range(4):
        local = o + ((height - o[:, 2]) / d[:, 2])[:, None] * d
        height = _rise(truth, PLANE_BOW, PLANE_FORM, PLANE_HALF_X_MM, local[:, :2])
    right = project(truth, "right", local @ pose.rotation.T + pose.at_mm)
    keep = (
        inside(right, truth.left.width_px)
        & (np.abs(local[:, 0]) < PLANE_HALF_X_MM)
        & (np.abs(local[:, 1]) < PLANE_HALF_Y_MM)
    )
    left, right = uv[keep][:points], right[keep][:points]
    right = right + rng.normal(0.0, 1.0, right.shape) * noise_px
    return Recording(name, ArtefactKind.PLANE, left, right, water, np.zeros(len(left), np.intp))


def _frustum_planes() -> tuple[Array, Array]:
    """Outward normals (6, 3) and offsets (6,) in the object's frame: top, plate, four sides in turn."""
    slope = 0.5 * (FRUSTUM_BASE_MM - FRUSTUM_TOP_MM) / FRUSTUM_HEIGHT_MM
    k = 1.0 / np.hypot(1.0, slope)
    sides = [(k * x, k * y, -k * slope) for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1))]
    normals = np.array([(0.0, 0.0, -1.0), (0.0, 0.0, -1.0), *sides])
    return normals, np.array([FRUSTUM_HEIGHT_MM, 0.0, *([0.5 * k * FRUSTUM_BASE_MM] * 4)])


def _meet_frustum(origin: Array, direction: Array) -> tuple[Array, Labels]:
    """Where rays (object's frame) first meet the frustum or its plate, and which face; −1: none."""
    normals, offsets = _frustum_planes()
    s = (offsets - origin @ normals.T) / (direction @ normals.T)
    best, face = np.full(len(origin), np.inf), np.full(len(origin), -1, np.intp)
    for k in range(6):
        at = origin + s[:, k : k + 1] * direction
        if k == 1:
            on = np.all(np.abs(at[:, :2]) < [0.5 * FRUSTUM_PLATE_X_MM, 0.5 * FRUSTUM_PLATE_Y_MM], axis=1)
        else:
            on = np.delete(at @ normals.T - offsets, [k, 1], axis=1).max(axis=1) < 1e-9
            on &= at[:, 2] < 1e-9
        nearer = on & (s[:, k] > 0.0) & (s[:, k] < best)
        best[nearer], face[nearer] = s[nearer, k], k
    return origin + np.where(np.isfinite(best), best, 0.0)[:, None] * direction, face


@dataclass(frozen=True, eq=False)
class FrustumPoints:
    """Matched pixels on the six faces of the frustum."""

    left_px: Array
    right_px: Array
    face: Labels
    """(n,): top, plate, sides in turn."""
    water: Water

    def length_errors(self, rig: StereoRig) -> dict[str, float]:
        """The largest relative error of each kind of length, measured as evaluation measures them."""
        points = triangulate(rig, self.left_px, self.right_px, self.water.index)
        planes = [orthogonal_plane(points[self.face == k]) for k in range(6)]

        def corner(*three: Plane) -> Array:
            normals = np.array([p.normal for p in three])
            return np.linalg.solve(normals, [np.dot(p.normal, p.centre_mm) for p in three])

        nobody = FitPoints(np.empty(0, np.intp), np.empty(0, np.uint32), np.empty(0), np.empty(0, np.intp))
        faces = [Face(plane, nobody) for plane in planes]
        pairs = [(planes[2 + k], planes[2 + (k + 1) % 4]) for k in range(4)]
        found = Frustum(
            faces[0],
            faces[1],
            (faces[2], faces[3], faces[4], faces[5]),
            np.array([corner(planes[0], *pair) for pair in pairs]),
            np.array([corner(planes[1], *pair) for pair in pairs]),
        )
        slanted = float(np.sqrt(2.0 * (0.5 * (FRUSTUM_BASE_MM - FRUSTUM_TOP_MM)) ** 2 + FRUSTUM_HEIGHT_MM**2))
        true = {"top": FRUSTUM_TOP_MM, "base": FRUSTUM_BASE_MM, "slanted": slanted, "height": FRUSTUM_HEIGHT_MM}
        return {name: max(abs(v / true[name] - 1.0) for v in values) for name, values in found.lengths_mm.items()}


def record_frustum(
    truth: TrueRig, pose: Pose, points: int, noise_px: float, seed: int, water: Water = WATER
) -> FrustumPoints:
    """The frustum, its top towards the instrument; about ``points`` points, none within 3 mm of an edge."""
    rng = np.random.default_rng([seed, truth.seed, 5])
    uv = np.round(rng.uniform([0, 0], [WIDTH_PX - 1, HEIGHT_PX - 1], (3 * points, 2)))
    origin, direction = ray(truth, "left", uv)
    R = pose.rotation
    at, face = _meet_frustum((origin - pose.at_mm) @ R, direction @ R)
    normals, offsets = _frustum_planes()
    distance = np.abs(at @ normals.T - offsets)
    distance[np.arange(len(at)), np.maximum(face, 0)] = np.inf
    keep = (face >= 0) & (distance.min(axis=1) > EDGE_MM)
    for side in ("right", "projector"):
        eye = (np.array(truth.eye(side).t_mm) - pose.at_mm) @ R
        sight = (at - eye) / np.linalg.norm(at - eye, axis=1, keepdims=True)
        keep &= _meet_frustum(np.broadcast_to(eye, at.shape), sight)[1] == face
    right = project(truth, "right", at @ R.T + pose.at_mm)
    keep &= inside(right)
    left, right, face = uv[keep][:points], right[keep][:points], face[keep][:points]
    right = right + rng.normal(0.0, 1.0, right.shape) * noise_px
    return FrustumPoints(left, right, face, water)


def calibration_recordings(
    truth: TrueRig,
    bars: Sequence[Pose] = CALIBRATION_BARS,
    planes: Sequence[Pose] = CALIBRATION_PLANES,
    noise_px: float = NOISE_PX,
) -> list[Recording]:
    """The four of the paper: two bars, two planes."""
    found = [record_bar(truth, p, f"bar {k}", 600, noise_px, 100 + k) for k, p in enumerate(bars)]
    return found + [record_plane(truth, p, f"plane {k}", 1500, noise_px, 200 + k) for k, p in enumerate(planes)]


@dataclass(frozen=True)
class Errors:
    """Largest deviations over unseen poses, percent."""

    length: float
    """E_L of the ball bar."""
    flatness: float
    """E_F of the plane, without noise."""
    frustum: float = 0.0
    """E_L of the frustum's lengths; 0 where none was asked for."""


def evaluate(
    truth: TrueRig, rig: StereoRig, bars: int = 10, planes: int = 7, frustums: int = 0, water: Water = WATER
) -> Errors:
    """Unseen poses: lengths with the noise of matching, flatness without it (a range would show the noise instead)."""
    seen_bars, seen_planes, seen_frustums = unseen(truth, bars, planes, frustums, water)
    lengths, ranges = [], []
    for bar in seen_bars:
        points = triangulate(rig, bar.left_px, bar.right_px, bar.water.index)
        a, b = (fit_sphere(points[bar.sphere == s])[0] for s in (0, 1))
        true_length = truth.artefacts.ball_distance_mm
        lengths.append(abs(float(np.linalg.norm(b - a)) - true_length) / true_length)
    for plane in seen_planes:
        points = triangulate(rig, plane.left_px, plane.right_px, plane.water.index)
        n, e = fit_plane(points)
        off = np.sort(points @ n - e)
        cut = round(0.0015 * len(off))
        ranges.append(float(off[-1 - cut] - off[cut]) / MEASURING_FIELD_MM)
    of_frustums = [max(frustum.length_errors(rig).values()) for frustum in seen_frustums]
    return Errors(100.0 * max(lengths), 100.0 * max(ranges), 100.0 * max(of_frustums, default=0.0))


@lru_cache(maxsize=4)
def unseen(
    truth: TrueRig, bars: int, planes: int, frustums: int, water: Water = WATER
) -> tuple[tuple[Recording, ...], tuple[Recording, ...], tuple[FrustumPoints, ...]]:
    """What judges a calibration of ``truth``: bars and frustums with the noise of matching, planes without.

    ``water`` is what the truth's optics are in and what the recordings say.
    """
    rng = np.random.default_rng([truth.seed, 77])
    seen_bars, seen_planes, seen_frustums = [], [], []
    for k in range(bars):
        pose = Pose(
            (float(rng.uniform(-20, 20)), float(rng.uniform(-15, 15)), float(rng.uniform(485, 560))),
            (0.0, float(rng.uniform(-40, 40)), float(rng.uniform(-90, 90))),
        )
        seen_bars.append(record_bar(truth, pose, f"unseen bar {k}", 1000, NOISE_PX, 300 + k, water))
    for k in range(planes):
        pose = Pose(
            (0.0, 0.0, float(rng.uniform(465, 580))), (float(rng.uniform(-20, 20)), float(rng.uniform(-20, 20)), 0.0)
        )
        seen_planes.append(record_plane(truth, pose, f"unseen plane {k}", 2000, 0.0, 400 + k, water))
    for k in range(frustums):
        pose = Pose(
            (float(rng.uniform(-10, 10)), float(rng.uniform(-8, 8)), float(rng.uniform(530, 570))),
            (float(rng.uniform(-10, 10)), float(rng.uniform(-10, 10)), float(rng.uniform(-180, 180))),
        )
        seen_frustums.append(record_frustum(truth, pose, FRUSTUM_POINTS, NOISE_PX, 500 + k, water))
    return tuple(seen_bars), tuple(seen_planes), tuple(seen_frustums)
