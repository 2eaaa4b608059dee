"""The overlap of a scan with the one before, from coarse clouds and small images, within half a second.

Common keypoints of the bright images give a pose, and the coarse clouds the overlap. An ambiguous or sliding pose gives
no number: a wrong one would send the diver away from a gap. "No overlap" is reported only where both scans are full of
keypoints that are also found in another image of the same scan, so that an overlap would have shown.

CoarseView      a scan as it is compared under water
coarse_view     prepares one from a coarse cloud and frames
compare         the overlap of two of them, in short pieces of work
share_on        the overlap at a pose

Symbols: A the scan before, B this one; u, v column and row of a pixel of the full image
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure.guidance import NO_OVERLAP, UNKNOWN, Overlap
from appliance.measure.overlap.albedo import Texture
from appliance.measure.overlap.coarse import Guess, guess_by_features, guess_by_shape, in_common, turn_error_mm
from appliance.measure.overlap.features import Features, Keypoints, find_keypoints, points_below
from appliance.measure.overlap.fine import PreparedScan, refine
from appliance.measure.overlap.patches import Array, Projection, patches_of
from appliance.measure.overlap.rigid import Rigid
from appliance.measure.points.organised import OrganisedCloud
from appliance.measure.points.table import Cloud

WORKING_WIDTH_PX = 640
"""Largest width at which images are searched."""
MAX_KEYPOINTS = 900
AGAIN_PX, AGAIN_ALIKE = 1.5, 0.85
"""Largest distance, and least cosine of descriptors, of one keypoint in two images of the same scan."""
AROUND_MM = 12.0
ENOUGH_AROUND = 5
"""Least number of keypoints within ``AROUND_MM`` of a point that they cover."""
ALIKE = 0.92
"""Least cosine between descriptors of keypoints that may be confused."""
MIN_COVERAGE = 0.55
"""Least keypoint coverage of both scans for the statement that they do not overlap."""
RIVAL = 0.5
"""Least share of the best pose's keypoints at another pose that makes both ambiguous: texture repeats."""
APART_MM = 3.0
"""Largest distance between points of both scans that are the same surface."""
REACH_MM = 100.0
"""Distance from the keypoints up to which a pose has to be right."""
AGREEING = 0.85
"""Least share of B's points before A's camera that lie on A's surface."""
BLOCK = 4
"""Side of a patch in points of a coarse cloud."""
HELD, MAX_OUTLIERS, MAX_FRONT, MAX_UNMET = 5.0, 0.05, 0.02, 0.1
"""Limits of a pose by shape alone, as in ``appliance.measure.overlap.pair``."""
LOOKED_AT = 1_500
"""Number of points from which the overlap is computed."""


@dataclass(slots=True, eq=False)
class CoarseView:
    """A scan as it is compared under water; costly parts are computed on demand."""

    points_mm: NDArray[np.float32]
    """(gh, gw, 3) in the left camera's frame, every ``stride_px``-th pixel; NaN where there is no point."""
    sigma_mm: NDArray[np.float32]
    stride_px: int
    pictures: tuple[NDArray[np.uint8], NDArray[np.uint8]]
    """Bright image and another one of the same light, reduced, (h, w)."""
    reduced: float
    """Pixels of the full image per pixel of these."""
    projection: Projection
    """Projection of the full image."""
    _marks: tuple[Keypoints, ...] = ()
    """Keypoints of the images that were searched so far."""
    _features: Features | None = None
    _shape: PreparedScan | None = None
    _surface: tuple[Array, Array] | None = None
    _coverage: float | None = None

    def search(self) -> Iterator[None]:
        """Find the keypoints, one image at a time: each takes 0.1 s."""
        for picture in self.pictures[len(self._marks) :]:
            self._marks = (*self._marks, find_keypoints(picture, MAX_KEYPOINTS))
            yield None
        self.features()

    def features(self) -> Features:
        """Return the keypoints that both images have, with their points."""
        if self._features is None:
            first, second = (
                *self._marks,
                *(find_keypoints(picture, MAX_KEYPOINTS) for picture in self.pictures[len(self._marks) :]),
            )
            uv_px = (first.uv_px + 0.5) * self.reduced - 0.5
            points = points_below(self.points_mm, uv_px / self.stride_px)
            confirmed = np.flatnonzero(
                np.isfinite(points[:, 2]) & _again(first.uv_px, first.descriptors, second.uv_px, second.descriptors)
            )
            confirmed = confirmed[np.argsort(-first.strength[confirmed])][:MAX_KEYPOINTS]
            self._features = Features(points[confirmed], first.descriptors[confirmed], first.strength[confirmed])
        return self._features

    def shape(self) -> PreparedScan:
        """Return the coarse cloud as patches without texture."""
        if self._shape is None:
            nothing = np.zeros(self.points_mm.shape[:2], np.uint8)
            cloud = OrganisedCloud(self.points_mm, self.sigma_mm, self.sigma_mm, self.sigma_mm, nothing)
            projection = replace(
                self.projection, terms=self.projection.terms / self.stride_px, size_px=self.points_mm.shape[:2]
            )
            patches = patches_of(cloud, projection, BLOCK)
            unknown = np.full(patches.sigma_mm.shape, np.nan)
            self._shape = PreparedScan(patches, Texture(unknown, np.full((*unknown.shape, 3), np.nan), unknown))
        return self._shape

    def surface(self) -> tuple[Array, Array]:
        """Return points (n, 3) of the coarse cloud, mm, and their unit normals (n, 3), towards the camera."""
        if self._surface is None:
            p = self.points_mm.astype(np.float64)
            across, down = np.full_like(p, np.nan), np.full_like(p, np.nan)
            across[:, 1:-1], down[1:-1] = p[:, 2:] - p[:, :-2], p[2:] - p[:-2]
            normal = np.cross(across, down)
            normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
            normal *= -np.sign((normal * p).sum(-1, keepdims=True))
            finite = np.isfinite(normal).all(-1)
            self._surface = p[finite], normal[finite]
        return self._surface

    def faintest(self) -> float:
        """Return the 5th percentile of the points' grey values in the bright image."""
        valid = np.isfinite(self.points_mm[..., 2])
        picture = self.pictures[0]
        row, column = (np.nonzero(valid)[k] * self.stride_px / self.reduced for k in (0, 1))
        h, w = picture.shape
        grey_dn = picture[np.minimum(row.astype(int), h - 1), np.minimum(column.astype(int), w - 1)]
        return float(np.percentile(grey_dn, 5.0)) if len(grey_dn) else 0.0

    def keypoint_coverage(self) -> float:
        """Return the share of the points that have enough unique keypoints around them."""
        if self._coverage is None:
            self._coverage = self._marked()
        return self._coverage

    def _marked(self) -> float:
        valid = np.isfinite(self.points_mm[..., 2])
        if not valid.any():
            return 0.0
        step = np.linalg.norm(self.points_mm[:, 1:] - self.points_mm[:, :-1], axis=-1)
        finite = step[np.isfinite(step)]
        side = 2 * round(AROUND_MM / max(float(np.median(finite)), 0.1)) + 1 if finite.size else 3
        pixels = self.projection.pixels(self.features().points_mm[_single(self.features())]) / self.stride_px
        count = np.zeros(valid.shape, np.float32)
        h, w = valid.shape
        cells = np.rint(pixels).astype(int)
        cells = cells[(cells[:, 0] >= 0) & (cells[:, 1] >= 0) & (cells[:, 0] < w) & (cells[:, 1] < h)]
        np.add.at(count, (cells[:, 1], cells[:, 0]), 1.0)
        around = cv2.boxFilter(count, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
        return float(np.count_nonzero(valid & (around > ENOUGH_AROUND - 0.5)) / np.count_nonzero(valid))


def coarse_view(
    cloud: Cloud, stride_px: int, bright: NDArray[np.uint8], same_light: NDArray[np.uint8], projection: Projection
) -> CoarseView:
    """Return the view of a scan by which it is compared.

    ``cloud``: the point of every ``stride_px``-th pixel; ``bright`` (h, w) uint8; ``same_light`` (n, h, w): frames
    whose mean has the same light. The arrays are copied.
    """
    h, w = bright.shape
    gh, gw = -(-h // stride_px), -(-w // stride_px)
    row, column = np.divmod(cloud.pixel.astype(np.int64), w)
    points = np.full((gh, gw, 3), np.nan, np.float32)
    sigma = np.full((gh, gw), np.nan, np.float32)
    points[row // stride_px, column // stride_px] = cloud.points_mm
    sigma[row // stride_px, column // stride_px] = cloud.sigma_mm
    reduced = max(1.0, w / WORKING_WIDTH_PX)
    small = [_small(frame, reduced) for frame in (bright, *same_light)]
    mean = np.rint(np.mean(small[1:], axis=0)).astype(np.uint8)
    return CoarseView(points, sigma, stride_px, (small[0], mean), reduced, projection)


def compare(a: CoarseView, b: CoarseView) -> Iterator[Overlap | None]:
    """Yield ``None`` after each piece of work of at most 0.1 s, and the overlap of ``b`` with ``a`` last."""
    yield from a.search()
    yield None
    yield from b.search()
    yield None
    guesses = guess_by_features(a.features(), b.features())
    if guesses:
        yield _by_features(a, b, guesses)
        return
    yield None
    if min(a.keypoint_coverage(), b.keypoint_coverage()) >= MIN_COVERAGE:
        yield NO_OVERLAP
        return
    yield from _by_shape(a, b)


def _by_features(a: CoarseView, b: CoarseView, guesses: list[Guess]) -> Overlap:
    best, *rivals = guesses
    if any(rival.support >= RIVAL * best.support for rival in rivals):
        return UNKNOWN
    # Keypoints along a line do not determine the rotation about it.
    if turn_error_mm(in_common(a.features(), b.features(), best.pose), REACH_MM) > 0.5 * APART_MM:
        return UNKNOWN
    return share_on(a, b, best.pose)


def _by_shape(a: CoarseView, b: CoarseView) -> Iterator[Overlap | None]:
    guesses = guess_by_shape(a.shape(), b.shape(), Rigid(np.eye(3), _middle(a) - _middle(b)), count_limit=3)
    yield None
    fits = []
    for guess in guesses:
        fit = refine(a.shape(), b.shape(), guess.pose, max_distance_mm=4.0, with_texture=False)
        if fit is not None and fit.outliers < MAX_OUTLIERS and fit.front < MAX_FRONT and fit.missing < MAX_UNMET:
            fits.append(fit)
        yield None
    # A sliding pose beside a determined one explains the scans as well: then the overlap is unknown.
    if len(fits) == 1 and fits[0].significance.min() >= HELD:
        yield share_on(a, b, fits[0].pose)
    else:
        yield UNKNOWN


def share_on(a: CoarseView, b: CoarseView, pose: Rigid) -> Overlap:
    """Return the share of B's points on A's surface; unknown if the surfaces contradict each other.

    ``pose``: that of B in A's frame.
    """
    points = b.points_mm[np.isfinite(b.points_mm[..., 2])].astype(np.float64)
    x = pose.of(points[:: max(1, len(points) // LOOKED_AT)])
    nearest = _distances(a, x)
    on = nearest < APART_MM
    has_surface = np.isfinite(nearest)
    if not len(x) or np.count_nonzero(on) < AGREEING * np.count_nonzero(has_surface):
        return UNKNOWN
    return Overlap(float(np.count_nonzero(on) / len(x)))


def _distances(a: CoarseView, x: Array) -> Array:
    """Return the distance (n,) of ``x`` (n, 3) from A's nearest point in the same pixels, mm; or infinity."""
    h, w = a.points_mm.shape[:2]
    with np.errstate(invalid="ignore"):
        cell = np.nan_to_num(np.rint(a.projection.pixels(x) / a.stride_px), nan=-9.0, posinf=-9.0, neginf=-9.0)
    cell = np.clip(cell, -9, max(h, w) + 9).astype(int)
    nearest = np.full(len(x), np.inf)
    for dv in (-1, 0, 1):
        for du in (-1, 0, 1):
            column, row = cell[:, 0] + du, cell[:, 1] + dv
            inside = (column >= 0) & (row >= 0) & (column < w) & (row < h)
            points_mm = a.points_mm[np.where(inside, row, 0), np.where(inside, column, 0)]
            distance_mm = np.linalg.norm(points_mm - x, axis=1)
            nearest = np.fmin(nearest, np.where(inside, distance_mm, np.inf))
    return nearest


def _again(
    uv: Array, descriptors: NDArray[np.float32], other_uv: Array, other_descriptors: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Return which keypoints (n,) the other image has, too: noise and particles do not appear twice."""
    if not len(uv) or not len(other_uv):
        return np.zeros(len(uv), bool)
    distance_px = np.hypot(uv[:, None, 0] - other_uv[None, :, 0], uv[:, None, 1] - other_uv[None, :, 1])
    return np.asarray(((distance_px < AGAIN_PX) & (descriptors @ other_descriptors.T > AGAIN_ALIKE)).any(axis=1))


def _single(features: Features) -> NDArray[np.bool_]:
    """Return which keypoints (n,) resemble no other one: those of a repeating grid would match anywhere."""
    alike = features.descriptors @ features.descriptors.T
    distance_mm = np.linalg.norm(features.points_mm[:, None] - features.points_mm[None], axis=-1)
    return np.asarray(~((alike > ALIKE) & (distance_mm > APART_MM)).any(axis=1))


def _middle(view: CoarseView) -> Array:
    points = view.points_mm[np.isfinite(view.points_mm[..., 2])]
    return np.median(points, axis=0).astype(np.float64) if len(points) else np.zeros(3)


def _small(picture: NDArray[np.uint8], reduced: float) -> NDArray[np.uint8]:
    if reduced == 1.0:
        return picture.copy()
    size = (round(picture.shape[1] / reduced), round(picture.shape[0] / reduced))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
