"""Compares a live picture with the scan that was kept: how much a scan from here would overlap it, and which way leads
to a good overlap.

Marks of the kept scan's bright picture, with their points, are looked for in a live picture; seen from one pose, they
tell the camera's (three points and a fourth, M. Fischler and R. Bolles 1981; X. Gao et al. 2003), refraction included.
The kept scan's points are then drawn into the live picture: the share of what the projector lights there that they
cover is the overlap. Nothing is supposed about what lies beyond.

Symbols: A the kept scan; x a point in A's frame, y the same in the camera's; u, v column and row of a pixel of the full
picture
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure.guidance import LEAST_GOOD, LOST, MOST_GOOD, Guidance, Overlap
from appliance.measure.light.model import HousedCamera
from appliance.measure.light.rotation import rotation_matrix
from appliance.measure.overlap.coarse import ENOUGH_INLIERS, matches, turn_error_mm
from appliance.measure.overlap.features import PictureMarks, marks_of
from appliance.measure.overlap.overlap import APART_MM, ENOUGH_AROUND, MOST_MARKS, REACH_MM, RIVAL, TOLD, CoarseView
from appliance.measure.overlap.patches import Array, Projection
from appliance.measure.overlap.rigid import Rigid

SAMPLES = 300
"""Triples that a pose is tried with."""
ROUGH_PX, NEAR_PX = 10.0, 4.0
"""Marks agree with a pose where they are seen so close, before and after refraction is in it; of 1600."""
STEPS = 5
CELLS = 80
"""Cells across the picture in which points and light are counted."""
FACING = 0.15
"""Least cosine between a point's normal and its ray from which the camera sees it."""
FADED = 0.5
"""A cell is lit where it has this share of the grey value that all but a twentieth of the kept scan's points had."""
BRIGHT_PERCENT = 95.0
"""Percentile of a picture's cells by which its exposure is told from another's."""
LEAST_LIT_DN = 8.0
LEAST_OWN = 0.5
"""The kept scan covers more than that of its own light, or it tells nothing of others."""
HERE = Rigid(np.eye(3), np.zeros(3))
LEAST_CELLS = 60
"""Lit cells without which there is nothing to scan."""
AWAY_MM = 12.0
"""Nearer to the kept view no way is farther from it than another."""
LONG = 1.4
"""Length of what is lit over its width from which its axis is a way."""
AROUND_PX = 40.0
"""Marks tell what lies so close, px of 1600."""


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """The camera that aims, in its water."""

    camera: HousedCamera
    water_index: float
    projection: Projection
    other: Projection
    """Projection of the other camera, for points in this one's frame: no scan finds what it does not see."""

    def by_both(self, shape: tuple[int, int], depth_mm: float) -> NDArray[np.bool_]:
        """Return which cells (h, w) of the picture the other camera sees, too, at ``depth_mm``."""
        h, w = shape
        v, u = np.mgrid[0:h, 0:w]
        uv = (np.stack([u, v], axis=-1).reshape(-1, 2) + 0.5) * (self.camera.width_px / w) - 0.5
        at = np.column_stack([self.directions(uv, depth_mm) * depth_mm, np.full(len(uv), depth_mm)])
        seen = self.other.pixels(at)
        high, wide = self.other.size_px
        return np.asarray(((seen > 0.0) & (seen < (wide - 1, high - 1))).all(axis=1).reshape(h, w))

    @property
    def pixels_per_1600th(self) -> float:
        """Return how many of this camera's pixels are one of a picture 1600 across."""
        return self.camera.width_px / 1600.0

    def directions(self, uv_px: Array, depth_mm: float) -> Array:
        """Return (n, 2) x/z and y/z of what lies at ``depth_mm`` on the rays of pixels (n, 2)."""
        origin, direction = self.camera.rays(uv_px, self.water_index)
        at = origin + direction * ((depth_mm - origin[:, 2]) / direction[:, 2])[:, None]
        return np.asarray(at[:, :2] / depth_mm)


class Guide:
    """Follows live pictures of one kept scan after another. Used by one thread."""

    def __init__(self, sight: Sight) -> None:
        self._sight = sight
        self._before: PictureMarks | None = None
        """Marks of the live picture before, whoever's scan was kept then."""

    def forget(self) -> None:
        """The pictures that follow have nothing to do with those before."""
        self._before = None

    def look(self, kept: CoarseView, picture: NDArray[np.uint8]) -> Iterator[Guidance | None]:
        """Look at a live ``picture`` (h, w) uint8, reduced as those of ``kept`` or more; yields ``None`` after each piece of work, at most some
        0.1 s, and one that is told last; nothing last: it cannot be told."""
        yield from kept.search()
        yield None
        marks = marks_of(picture, MOST_MARKS)
        before, self._before = self._before, marks
        yield None
        reduced = self._sight.camera.width_px / picture.shape[1]
        features = kept.features()
        pairs = matches(features.descriptors, marks.descriptors)
        seen_px = (marks.uv_px + 0.5) * reduced - 0.5
        found = camera_pose(self._sight, features.points_mm[pairs[:, 0]], seen_px[pairs[:, 1]])
        if found is not None:
            guidance = self._told(kept, picture, found)
            if guidance is not None:
                yield guidance
        elif before is not None and kept.told() >= TOLD and self._known_again(before, marks, picture) >= TOLD:
            yield LOST

    def _told(self, kept: CoarseView, picture: NDArray[np.uint8], pose: Rigid) -> Guidance | None:
        lit = self._lit(kept, picture)
        if np.count_nonzero(lit) < LEAST_CELLS:
            return None
        # Of what is lit no scan finds all (dark paint, steep flanks): the kept one tells how much.
        own = self._covered(kept, self._lit(kept, kept.pictures[0]), HERE)
        share = min(1.0, self._covered(kept, lit, pose) / max(own, LEAST_OWN))
        return Guidance(Overlap(share), self._way(lit, pose.of(kept.surface()[0]), share))

    def _covered(self, kept: CoarseView, lit: NDArray[np.bool_], pose: Rigid) -> float:
        """Return the share of the cells ``lit`` (h, w) that points of the kept scan cover where the camera is at
        ``pose``."""
        points, normals = kept.surface()
        y = pose.of(points)
        facing = -(y * (normals @ pose.rotation.T)).sum(1) > FACING * np.linalg.norm(y, axis=1)
        uv = self._sight.projection.pixels(y[facing])
        h, w = lit.shape
        cell = np.floor((uv[np.isfinite(uv).all(1)] + 0.5) * (w / self._sight.camera.width_px))
        cell = cell[(cell >= 0).all(1) & (cell[:, 0] < w) & (cell[:, 1] < h)].astype(int)
        covered = np.zeros((h, w), np.uint8)
        covered[cell[:, 1], cell[:, 0]] = 1
        closed = np.asarray(cv2.morphologyEx(covered, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)), np.uint8)
        wanted = lit & self._sight.by_both((h, w), float(np.median(y[:, 2])))
        return float(np.count_nonzero(wanted & (closed > 0)) / max(1, int(np.count_nonzero(wanted))))

    def _lit(self, kept: CoarseView, picture: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Return which cells (h, w) of the picture show something that a scan would find points on."""
        size = (CELLS, round(CELLS * picture.shape[0] / picture.shape[1]))
        grey, theirs = (cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in (picture, kept.pictures[0]))
        # The diver may have chosen another exposure since.
        brighter = float(np.percentile(grey, BRIGHT_PERCENT)) / max(1.0, float(np.percentile(theirs, BRIGHT_PERCENT)))
        return np.asarray(grey > max(LEAST_LIT_DN, FADED * brighter * kept.faintest()))

    def _way(self, lit: NDArray[np.bool_], y: Array, share: float) -> tuple[float, float] | None:
        """Return the direction of a good view."""
        if LEAST_GOOD <= share <= MOST_GOOD:
            return None
        middle = np.median(y, axis=0)
        # How far what the picture's middle shows is from the middle of the kept scan, along the picture.
        camera = self._sight.camera
        centre = np.array([[(camera.width_px - 1) / 2.0, (camera.height_px - 1) / 2.0]])
        way = middle[:2] - self._sight.directions(centre, float(middle[2]))[0] * middle[2]
        if share > MOST_GOOD:
            # Away from it, but not off something long.
            axis = long_axis(lit)
            way = -way if axis is None else -axis * float(axis @ way)
        length = float(np.linalg.norm(way))
        return None if length < AWAY_MM else (float(way[0] / length), float(way[1] / length))

    def _known_again(self, before: PictureMarks, marks: PictureMarks, picture: NDArray[np.uint8]) -> float:
        """Return the share of the lit picture that has marks around it which the picture before had, too: with such
        marks an overlap would show."""
        pairs = matches(before.descriptors, marks.descriptors)
        count = np.zeros(picture.shape, np.float32)
        at = np.clip(np.rint(marks.uv_px[pairs[:, 1]]).astype(int), 0, (picture.shape[1] - 1, picture.shape[0] - 1))
        np.add.at(count, (at[:, 1], at[:, 0]), 1.0)
        side = 2 * round(AROUND_PX * picture.shape[1] / 1600.0) + 1
        around = cv2.boxFilter(count, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
        lit = picture > LEAST_LIT_DN
        return float(np.count_nonzero(lit & (around > ENOUGH_AROUND - 0.5)) / max(1, int(np.count_nonzero(lit))))


def camera_pose(sight: Sight, points_mm: Array, uv_px: Array) -> Rigid | None:
    """Return where points (n, 3) of A are in the frame of the camera that sees them at pixels (n, 2); ``None``: too few
    agree, or only along a line, or another pose has as good a claim."""
    if len(points_mm) < ENOUGH_INLIERS:
        return None
    depth_mm = float(np.median(points_mm[:, 2]))
    seen = sight.directions(uv_px, depth_mm)
    near_px = NEAR_PX * sight.pixels_per_1600th
    first = _agreed(sight, points_mm, seen, uv_px)
    if first is None:
        return None
    pose, agree = first
    support = _witnesses(points_mm[agree])
    if support < ENOUGH_INLIERS or turn_error_mm(points_mm[agree], REACH_MM) > 0.5 * APART_MM:
        return None
    # What agrees with another pose repeats, and either may be wrong.
    others = ~(_off_px(sight.projection, pose, points_mm, uv_px) < 2.0 * near_px)
    rival = _agreed(sight, points_mm[others], seen[others], uv_px[others])
    if rival is not None and _witnesses(points_mm[others][rival[1]]) >= max(RIVAL * support, 4):
        return None
    return pose


def _agreed(sight: Sight, points_mm: Array, seen: Array, uv_px: Array) -> tuple[Rigid, NDArray[np.bool_]] | None:
    """Return the pose that most points agree with, and which (n,) do."""
    if len(points_mm) < ENOUGH_INLIERS:
        return None
    step = np.array([[0.0, 0.0], [1.0, 0.0]]) + 0.5 * sight.camera.width_px
    depth_mm = float(np.median(points_mm[:, 2]))
    per_px = float(np.diff(sight.directions(step, depth_mm)[:, 0])[0])
    # Of one pixel's rays the pinhole is true at one depth only; the rest is for the refinement.
    try:
        good, turn, shift, _ = cv2.solvePnPRansac(
            points_mm,
            seen,
            np.eye(3),
            None,
            iterationsCount=SAMPLES,
            reprojectionError=ROUGH_PX * sight.pixels_per_1600th * per_px,
            confidence=0.999,
            flags=cv2.SOLVEPNP_AP3P,
        )
    except cv2.error:
        # Points that all lie in one place, or on a line: then no pose is to be had, which is no fault of anybody's.
        return None
    if not good:
        return None
    pose = Rigid(np.asarray(cv2.Rodrigues(turn)[0], np.float64), np.asarray(shift, np.float64).ravel())
    limit_px = ROUGH_PX * sight.pixels_per_1600th
    for _ in range(STEPS):
        off = _off_px(sight.projection, pose, points_mm, uv_px)
        agree = off < limit_px
        if np.count_nonzero(agree) < ENOUGH_INLIERS:
            return None
        pose = _stepped(sight.projection, pose, points_mm[agree], uv_px[agree])
        limit_px = max(NEAR_PX * sight.pixels_per_1600th, 0.6 * limit_px)
    agree = _off_px(sight.projection, pose, points_mm, uv_px) < NEAR_PX * sight.pixels_per_1600th
    return (pose, agree) if np.count_nonzero(agree) >= ENOUGH_INLIERS else None


def _off_px(projection: Projection, pose: Rigid, points_mm: Array, uv_px: Array) -> Array:
    """Return (n,) how far from their pixels points are seen; infinite for what is not before the camera."""
    off = np.linalg.norm(projection.pixels(pose.of(points_mm)) - uv_px, axis=1)
    return np.where(np.isfinite(off), off, np.inf)


def _stepped(projection: Projection, pose: Rigid, points_mm: Array, uv_px: Array) -> Rigid:
    """Return the pose after a step of Gauss and Newton's, with slopes by differences of 0.1 mm and as much of turn."""
    middle = points_mm.mean(axis=0)
    y = pose.of(points_mm) - pose.of(middle)
    centre = pose.of(middle)
    now = projection.pixels(y + centre)
    h_mm, h_rad = 0.1, 0.001
    slopes = []
    for axis in np.eye(3):
        slopes.append((projection.pixels(y @ rotation_matrix(h_rad * axis).T + centre) - now) / h_rad)
    for axis in np.eye(3):
        slopes.append((projection.pixels(y + centre + h_mm * axis) - now) / h_mm)
    jacobian = np.stack(slopes, axis=-1).reshape(-1, 6)
    step = np.linalg.lstsq(jacobian, (uv_px - now).ravel(), rcond=None)[0]
    rotation = rotation_matrix(np.asarray(step[:3], np.float64))
    return Rigid(rotation @ pose.rotation, centre + step[3:] - rotation @ pose.rotation @ middle)


def _witnesses(points_mm: Array) -> int:
    """Return how many places agree: several marks at one place are one witness."""
    return len(np.unique(np.round(points_mm / 3.0), axis=0))


def long_axis(lit: NDArray[np.bool_]) -> Array | None:
    """Return the direction (2,), right and down, that what is lit extends in; ``None``: it is about as long as wide."""
    row, column = np.nonzero(lit)
    values, vectors = np.linalg.eigh(np.cov(np.stack([column, row]).astype(np.float64)))
    return vectors[:, 1] if values[1] > LONG**2 * values[0] else None
