"""Guidance to the next view: the overlap of a scan from the present pose, and the direction to a better one.

Keypoints of the kept scan's bright image, with their points, are matched with a live image. They determine the camera's
pose (P3P within RANSAC, M. Fischler and R. Bolles 1981; X. Gao et al. 2003), refraction included. The kept scan's
points are then projected into the live image. The overlap is the share of the illuminated cells that they cover.
Nothing is assumed about what lies beyond.

Sight          the camera that aims, in its water
Guide          the comparison of one live image after another
camera_pose    the pose of the camera from keypoints

Symbols: A the kept scan; x a point in A's frame, y the same in the camera's; u, v column and row of a pixel of the full
image
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
from appliance.measure.overlap.features import Keypoints, find_keypoints
from appliance.measure.overlap.overlap import (
    APART_MM,
    ENOUGH_AROUND,
    MAX_KEYPOINTS,
    MIN_COVERAGE,
    REACH_MM,
    RIVAL,
    CoarseView,
)
from appliance.measure.overlap.patches import Array, Projection
from appliance.measure.overlap.rigid import Rigid

SAMPLES = 300
"""Number of RANSAC samples."""
ROUGH_PX, NEAR_PX = 10.0, 4.0
"""Largest reprojection error of inliers without and with refraction, in px of an image 1600 across."""
STEPS = 5
CELLS = 80
"""Number of cells across the image in which points and light are counted."""
FACING = 0.15
"""Least cosine between normal and ray of a point that the camera sees."""
FADED = 0.5
"""Least grey value of an illuminated cell, over the 5th percentile of those of the kept scan's points."""
BRIGHT_PERCENT = 95.0
"""Percentile of an image's cells by which exposures are compared."""
LEAST_LIT_DN = 8.0
MIN_KEPT_COVERAGE = 0.5
"""Least share of the illuminated cells of its own view that the kept scan counts as covering."""
AT_THE_KEPT_VIEW = Rigid(np.eye(3), np.zeros(3))
LEAST_CELLS = 60
"""Fewest illuminated cells of an image in which there is an object."""
AWAY_MM = 12.0
"""Least distance from the kept view at which there is a direction to it."""
MIN_ELONGATION = 1.4
"""Least length over width of the illuminated area for which it has a long axis."""
AROUND_PX = 40.0
"""Radius that a keypoint covers, in px of an image 1600 across."""


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """The camera that aims, in its water."""

    camera: HousedCamera
    water_index: float
    projection: Projection
    second: Projection
    """Projection of the other camera, for points in this one's frame: a scan needs both cameras."""

    def by_both(self, shape: tuple[int, int], depth_mm: float) -> NDArray[np.bool_]:
        """Return which cells (h, w) of the image the other camera sees, too, at ``depth_mm``."""
        h, w = shape
        v, u = np.mgrid[0:h, 0:w]
        uv = (np.stack([u, v], axis=-1).reshape(-1, 2) + 0.5) * (self.camera.width_px / w) - 0.5
        points_mm = np.column_stack([self.directions(uv, depth_mm) * depth_mm, np.full(len(uv), depth_mm)])
        pixels_px = self.second.pixels(points_mm)
        high, wide = self.second.size_px
        return np.asarray(((pixels_px > 0.0) & (pixels_px < (wide - 1, high - 1))).all(axis=1).reshape(h, w))

    @property
    def pixels_per_1600th(self) -> float:
        """The number of this camera's pixels per pixel of an image 1600 across."""
        return self.camera.width_px / 1600.0

    def directions(self, uv_px: Array, depth_mm: float) -> Array:
        """Return (n, 2) x/z and y/z of the points at ``depth_mm`` on the rays of pixels (n, 2)."""
        origin, direction = self.camera.rays(uv_px, self.water_index)
        points_mm = origin + direction * ((depth_mm - origin[:, 2]) / direction[:, 2])[:, None]
        return np.asarray(points_mm[:, :2] / depth_mm)


class Guide:
    """Compares live images with one kept scan after another. Used by one thread."""

    def __init__(self, sight: Sight) -> None:
        self._sight = sight
        self._before: Keypoints | None = None
        """Keypoints of the live image before, also across a change of the kept scan."""

    def forget(self) -> None:
        """Forget the live image before: those that follow are of another place."""
        self._before = None

    def look(self, kept_scan: CoarseView, image: NDArray[np.uint8]) -> Iterator[Guidance | None]:
        """Yield ``None`` after each piece of work of at most 0.1 s, and the guidance last, if there is any.

        ``image``: the live image (h, w) uint8, reduced at least as much as those of ``kept_scan``.
        """
        yield from kept_scan.search()
        yield None
        keypoints = find_keypoints(image, MAX_KEYPOINTS)
        before, self._before = self._before, keypoints
        yield None
        reduced = self._sight.camera.width_px / image.shape[1]
        features = kept_scan.features()
        pairs = matches(features.descriptors, keypoints.descriptors)
        seen_px = (keypoints.uv_px + 0.5) * reduced - 0.5
        pose = camera_pose(self._sight, features.points_mm[pairs[:, 0]], seen_px[pairs[:, 1]])
        if pose is not None:
            guidance = self._guidance_at(kept_scan, image, pose)
            if guidance is not None:
                yield guidance
        elif (
            before is not None
            and kept_scan.keypoint_coverage() >= MIN_COVERAGE
            and self._share_seen_before(before, keypoints, image) >= MIN_COVERAGE
        ):
            yield LOST

    def _guidance_at(self, kept_scan: CoarseView, image: NDArray[np.uint8], pose: Rigid) -> Guidance | None:
        """Return the guidance for a scan at ``pose``; ``None`` where the image shows no object."""
        illuminated = self._surface_cells(kept_scan, image)
        if np.count_nonzero(illuminated) < LEAST_CELLS:
            return None
        # No scan covers all that is illuminated (dark texture, steep flanks): the kept scan shows how much.
        kept_coverage = self._coverage(
            kept_scan, self._surface_cells(kept_scan, kept_scan.pictures[0]), AT_THE_KEPT_VIEW
        )
        share = min(1.0, self._coverage(kept_scan, illuminated, pose) / max(kept_coverage, MIN_KEPT_COVERAGE))
        return Guidance(
            Overlap(share), self._direction_to_good_view(illuminated, pose.of(kept_scan.surface()[0]), share)
        )

    def _coverage(self, kept_scan: CoarseView, illuminated: NDArray[np.bool_], pose: Rigid) -> float:
        """Return the share of the ``illuminated`` cells (h, w) that the kept scan's points cover at ``pose``."""
        points, normals = kept_scan.surface()
        y = pose.of(points)
        facing = -(y * (normals @ pose.rotation.T)).sum(1) > FACING * np.linalg.norm(y, axis=1)
        uv = self._sight.projection.pixels(y[facing])
        h, w = illuminated.shape
        cell = np.floor((uv[np.isfinite(uv).all(1)] + 0.5) * (w / self._sight.camera.width_px))
        cell = cell[(cell >= 0).all(1) & (cell[:, 0] < w) & (cell[:, 1] < h)].astype(int)
        covered = np.zeros((h, w), np.uint8)
        covered[cell[:, 1], cell[:, 0]] = 1
        closed = np.asarray(cv2.morphologyEx(covered, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)), np.uint8)
        visible = illuminated & self._sight.by_both((h, w), float(np.median(y[:, 2])))
        return float(np.count_nonzero(visible & (closed > 0)) / max(1, int(np.count_nonzero(visible))))

    def _surface_cells(self, kept_scan: CoarseView, image: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Return which cells (h, w) of the image show a surface on which a scan would have points."""
        size = (CELLS, round(CELLS * image.shape[0] / image.shape[1]))
        grey, kept_grey = (
            cv2.resize(each, size, interpolation=cv2.INTER_AREA) for each in (image, kept_scan.pictures[0])
        )
        # The exposure may have been changed since.
        brighter = float(np.percentile(grey, BRIGHT_PERCENT)) / max(
            1.0, float(np.percentile(kept_grey, BRIGHT_PERCENT))
        )
        return np.asarray(grey > max(LEAST_LIT_DN, FADED * brighter * kept_scan.faintest()))

    def _direction_to_good_view(
        self, illuminated: NDArray[np.bool_], y: Array, share: float
    ) -> tuple[float, float] | None:
        """Return the direction (x, y) to a good view; ``None`` if this is one."""
        if LEAST_GOOD <= share <= MOST_GOOD:
            return None
        middle = np.median(y, axis=0)
        # From the point in the middle of the image to the middle of the kept scan, along the image.
        camera = self._sight.camera
        centre = np.array([[(camera.width_px - 1) / 2.0, (camera.height_px - 1) / 2.0]])
        offset_mm = middle[:2] - self._sight.directions(centre, float(middle[2]))[0] * middle[2]
        if share > MOST_GOOD:
            # Away from the kept scan, but along a long object, not off it.
            axis = long_axis(illuminated)
            offset_mm = -offset_mm if axis is None else -axis * float(axis @ offset_mm)
        length = float(np.linalg.norm(offset_mm))
        return None if length < AWAY_MM else (float(offset_mm[0] / length), float(offset_mm[1] / length))

    def _share_seen_before(self, before: Keypoints, keypoints: Keypoints, image: NDArray[np.uint8]) -> float:
        """Return the share of the illuminated image that lies around keypoints of the live image before."""
        pairs = matches(before.descriptors, keypoints.descriptors)
        count = np.zeros(image.shape, np.float32)
        cells = np.clip(np.rint(keypoints.uv_px[pairs[:, 1]]).astype(int), 0, (image.shape[1] - 1, image.shape[0] - 1))
        np.add.at(count, (cells[:, 1], cells[:, 0]), 1.0)
        side = 2 * round(AROUND_PX * image.shape[1] / 1600.0) + 1
        around = cv2.boxFilter(count, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
        illuminated = image > LEAST_LIT_DN
        return float(
            np.count_nonzero(illuminated & (around > ENOUGH_AROUND - 0.5)) / max(1, int(np.count_nonzero(illuminated)))
        )


def camera_pose(sight: Sight, points_mm: Array, uv_px: Array) -> Rigid | None:
    """Return the transform from A to the frame of the camera that sees points (n, 3) at pixels (n, 2).

    ``None`` if too few points agree, if they lie along a line, or if another pose has similar support.
    """
    if len(points_mm) < ENOUGH_INLIERS:
        return None
    depth_mm = float(np.median(points_mm[:, 2]))
    directions = sight.directions(uv_px, depth_mm)
    near_px = NEAR_PX * sight.pixels_per_1600th
    first = _agreed(sight, points_mm, directions, uv_px)
    if first is None:
        return None
    pose, agree = first
    support = _witnesses(points_mm[agree])
    if support < ENOUGH_INLIERS or turn_error_mm(points_mm[agree], REACH_MM) > 0.5 * APART_MM:
        return None
    # Points that agree with another pose mean that the texture repeats, and either pose may be wrong.
    outliers = ~(_off_px(sight.projection, pose, points_mm, uv_px) < 2.0 * near_px)
    rival = _agreed(sight, points_mm[outliers], directions[outliers], uv_px[outliers])
    if rival is not None and _witnesses(points_mm[outliers][rival[1]]) >= max(RIVAL * support, 4):
        return None
    return pose


def _agreed(sight: Sight, points_mm: Array, directions: Array, uv_px: Array) -> tuple[Rigid, NDArray[np.bool_]] | None:
    """Return the pose with the most inliers, and which points (n,) are inliers."""
    if len(points_mm) < ENOUGH_INLIERS:
        return None
    step = np.array([[0.0, 0.0], [1.0, 0.0]]) + 0.5 * sight.camera.width_px
    depth_mm = float(np.median(points_mm[:, 2]))
    per_px = float(np.diff(sight.directions(step, depth_mm)[:, 0])[0])
    # The pinhole approximates the refracted rays at one depth only; the refinement removes the rest.
    try:
        success, rotation_vector_rad, shift, _ = cv2.solvePnPRansac(
            points_mm,
            directions,
            np.eye(3),
            None,
            iterationsCount=SAMPLES,
            reprojectionError=ROUGH_PX * sight.pixels_per_1600th * per_px,
            confidence=0.999,
            flags=cv2.SOLVEPNP_AP3P,
        )
    except cv2.error:
        # Points in one place or on a line determine no pose.
        return None
    if not success:
        return None
    pose = Rigid(np.asarray(cv2.Rodrigues(rotation_vector_rad)[0], np.float64), np.asarray(shift, np.float64).ravel())
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
    """Return the reprojection errors (n,), px; infinite for points behind the camera."""
    off = np.linalg.norm(projection.pixels(pose.of(points_mm)) - uv_px, axis=1)
    return np.where(np.isfinite(off), off, np.inf)


def _stepped(projection: Projection, pose: Rigid, points_mm: Array, uv_px: Array) -> Rigid:
    """Return the pose after a Gauss-Newton step, with numerical derivatives."""
    middle = points_mm.mean(axis=0)
    y = pose.of(points_mm) - pose.of(middle)
    centre = pose.of(middle)
    pixels_px = projection.pixels(y + centre)
    h_mm, h_rad = 0.1, 0.001
    slopes = []
    for axis in np.eye(3):
        slopes.append((projection.pixels(y @ rotation_matrix(h_rad * axis).T + centre) - pixels_px) / h_rad)
    for axis in np.eye(3):
        slopes.append((projection.pixels(y + centre + h_mm * axis) - pixels_px) / h_mm)
    jacobian = np.stack(slopes, axis=-1).reshape(-1, 6)
    step = np.linalg.lstsq(jacobian, (uv_px - pixels_px).ravel(), rcond=None)[0]
    rotation = rotation_matrix(np.asarray(step[:3], np.float64))
    return Rigid(rotation @ pose.rotation, centre + step[3:] - rotation @ pose.rotation @ middle)


def _witnesses(points_mm: Array) -> int:
    """Return the number of places that agree: several keypoints at one place count once."""
    return len(np.unique(np.round(points_mm / 3.0), axis=0))


def long_axis(illuminated: NDArray[np.bool_]) -> Array | None:
    """Return the direction (2,), right and down, of the longest extent; ``None`` if it is not elongated."""
    row, column = np.nonzero(illuminated)
    values, vectors = np.linalg.eigh(np.cov(np.stack([column, row]).astype(np.float64)))
    return vectors[:, 1] if values[1] > MIN_ELONGATION**2 * values[0] else None
