"""Calibration objects before a hidden rig, point by point: exact optics of the simulator, noise of the matching."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.calibration.air import AirCalibration, BoardView, calibrate_air
from appliance.calibration.design import Design, design_calibration
from appliance.calibration.file import Calibration
from appliance.calibration.recordings import ArtefactKind, Recording
from appliance.calibration.shapes import fit_plane, fit_sphere, triangulate
from appliance.optics.model import StereoRig
from hw_sim.objects.shapes import BALL_DISTANCE_MM, BALL_RADIUS_MM, PLANE_HALF_X_MM, PLANE_HALF_Y_MM
from hw_sim.optics.points import project, ray
from hw_sim.truth import TrueRig, draw_truth, in_air
from tests.support.truth import WATER

Array = NDArray[np.float64]

DESIGN = Design(11.5, 4.5, 230.0, 12.41, 30.0, 5.0, 1.77)
NOISE_PX = 0.04
CORNER_NOISE_PX = 0.03
WIDTH_PX, HEIGHT_PX = 1600, 1200
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


def hidden_rig(truth_set: str, seed: int) -> TrueRig:
    return draw_truth(truth_set, seed, WIDTH_PX, HEIGHT_PX, WATER.index)


def board_views(truth: TrueRig, count: int = 20, seed: int = 1) -> list[BoardView]:
    """A board of 14 × 11 corners, 18 mm apart, before the instrument in air."""
    rng = np.random.default_rng([seed, truth.seed])
    dry = in_air(truth)
    x, y = np.meshgrid((np.arange(14) - 6.5) * 18.0, (np.arange(11) - 5.0) * 18.0)
    corners = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], -1)
    views = []
    for k in range(count):
        pose = Pose(
            (float(rng.uniform(-40, 40)), float(rng.uniform(-30, 30)), float(rng.uniform(470, 640))),
            (float(rng.uniform(-30, 30)), float(rng.uniform(-30, 30)), float(rng.uniform(-180, 180))),
        )
        points = corners @ pose.rotation.T + pose.at_mm
        seen = {side: project(dry, side, points) for side in ("left", "right")}
        keep = inside(seen["left"]) & inside(seen["right"])
        noisy = {side: uv[keep] + rng.normal(0, CORNER_NOISE_PX, (keep.sum(), 2)) for side, uv in seen.items()}
        views.append(BoardView(f"board {k}", corners[keep], noisy["left"], noisy["right"]))
    return views


def air_of(truth: TrueRig) -> AirCalibration:
    return calibrate_air(board_views(truth), WIDTH_PX, HEIGHT_PX)


def start_of(air: AirCalibration) -> Calibration:
    """What is known before any recording in water: lenses and pose from air, ports from the drawing."""
    design = design_calibration(DESIGN, "KF-0001", WIDTH_PX, HEIGHT_PX, WATER)
    left, right = (
        replace(measured, port=drawn.port)
        for measured, drawn in ((air.rig.left, design.rig.left), (air.rig.right, design.rig.right))
    )
    return replace(design, method="air", made_from=("boards in air",), rig=StereoRig(left, right))


def inside(uv: Array) -> NDArray[np.bool_]:
    with np.errstate(invalid="ignore"):
        return np.asarray(np.all((uv >= 0) & (uv <= [WIDTH_PX - 1, HEIGHT_PX - 1]), axis=1))


def record_bar(truth: TrueRig, pose: Pose, name: str, points: int, noise_px: float, seed: int) -> Recording:
    """A ball bar along the pose's x axis; ``points`` per sphere at most."""
    rng = np.random.default_rng([seed, truth.seed, 3])
    half = 0.5 * truth.artefacts.ball_distance_mm
    pairs = []
    for sphere, x in enumerate((-half, half)):
        centre = pose.rotation @ [x, 0.0, 0.0] + pose.at_mm
        middle = project(truth, "left", centre)[0]
        size = 1.2 * BALL_RADIUS_MM / 0.16
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
        keep = inside(left) & inside(right)
        left, right = left[keep][:points], right[keep][:points]
        pairs.append((left, right, np.full(len(left), sphere)))
    left, right, label = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    right = right + rng.normal(0.0, 1.0, right.shape) * noise_px
    return Recording(
        name, ArtefactKind.BALL_BAR, left, right, WATER, label, length_mm=BALL_DISTANCE_MM, radius_mm=BALL_RADIUS_MM
    )


def record_plane(truth: TrueRig, pose: Pose, name: str, points: int, noise_px: float, seed: int) -> Recording:
    """The plane across the pose's z axis, bent as the truth says; about ``points`` points."""
    rng = np.random.default_rng([seed, truth.seed, 4])
    uv = np.round(rng.uniform([0, 0], [WIDTH_PX - 1, HEIGHT_PX - 1], (2 * points, 2)))
    origin, direction = ray(truth, "left", uv)
    o = (origin - pose.at_mm) @ pose.rotation
    d = direction @ pose.rotation
    height = np.zeros(len(uv))
    for _ in range(4):
        local = o + ((height - o[:, 2]) / d[:, 2])[:, None] * d
        height = truth.artefacts.plane_bow_mm * (1.0 - 2.0 * np.sum(local[:, :2] ** 2, 1) / PLANE_HALF_X_MM**2)
    right = project(truth, "right", local @ pose.rotation.T + pose.at_mm)
    keep = inside(right) & (np.abs(local[:, 0]) < PLANE_HALF_X_MM) & (np.abs(local[:, 1]) < PLANE_HALF_Y_MM)
    left, right = uv[keep][:points], right[keep][:points]
    right = right + rng.normal(0.0, 1.0, right.shape) * noise_px
    return Recording(name, ArtefactKind.PLANE, left, right, WATER, np.zeros(len(left), np.intp))


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


def evaluate(truth: TrueRig, rig: StereoRig, bars: int = 10, planes: int = 7) -> Errors:
    """Unseen poses: lengths with the noise of matching, flatness without it (a range would show the noise instead)."""
    rng = np.random.default_rng([truth.seed, 77])
    lengths, ranges = [], []
    for k in range(bars):
        pose = Pose(
            (float(rng.uniform(-20, 20)), float(rng.uniform(-15, 15)), float(rng.uniform(485, 560))),
            (0.0, float(rng.uniform(-40, 40)), float(rng.uniform(-90, 90))),
        )
        bar = record_bar(truth, pose, f"unseen bar {k}", 1000, NOISE_PX, 300 + k)
        points = triangulate(rig, bar.left_px, bar.right_px, bar.water.index)
        a, b = (fit_sphere(points[bar.sphere == s])[0] for s in (0, 1))
        true_length = truth.artefacts.ball_distance_mm
        lengths.append(abs(float(np.linalg.norm(b - a)) - true_length) / true_length)
    for k in range(planes):
        pose = Pose(
            (0.0, 0.0, float(rng.uniform(465, 580))),
            (float(rng.uniform(-20, 20)), float(rng.uniform(-20, 20)), 0.0),
        )
        plane = record_plane(truth, pose, f"unseen plane {k}", 2000, 0.0, 400 + k)
        points = triangulate(rig, plane.left_px, plane.right_px, plane.water.index)
        n, e = fit_plane(points)
        off = np.sort(points @ n - e)
        cut = round(0.0015 * len(off))
        ranges.append(float(off[-1 - cut] - off[cut]) / MEASURING_FIELD_MM)
    return Errors(100.0 * max(lengths), 100.0 * max(ranges))
