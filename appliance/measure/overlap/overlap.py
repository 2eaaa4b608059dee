"""Owns how much of a scan the one before has seen, too, told from coarse clouds and small pictures within half a
second.

Marks of the bright image that both scans have give a pose, the coarse clouds the share. What fits as well elsewhere, or
slides, gives no number: a wrong one would send the diver away from a gap. That nothing is in common is said only where
both scans are full of marks that are seen again in another picture of the same scan, so that an overlap would have
shown.

Symbols: A the scan before, B this one; u, v column and row of a pixel of the full picture
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure.guidance import NO_OVERLAP, UNKNOWN, Overlap
from appliance.measure.overlap.albedo import Paint
from appliance.measure.overlap.coarse import Guess, guess_by_features, guess_by_shape, in_common, turn_error_mm
from appliance.measure.overlap.features import Features, PictureMarks, marks_of, points_below
from appliance.measure.overlap.fine import Prepared, refine
from appliance.measure.overlap.patches import Array, Projection, patches_of
from appliance.measure.overlap.rigid import Rigid
from appliance.measure.points.organised import OrganisedCloud
from appliance.measure.points.table import Cloud

WORKING_WIDTH_PX = 640
"""Pictures are searched at this width at most."""
MOST_MARKS = 900
AGAIN_PX, AGAIN_ALIKE = 1.5, 0.85
"""A mark is there again in another picture of the same scan where one lies so near, with so similar a descriptor
(cosine)."""
AROUND_MM = 12.0
ENOUGH_AROUND = 5
"""A point is told by marks where so many lie around it."""
ALIKE = 0.92
"""Least cosine between descriptors of marks that may be taken for each other."""
TOLD = 0.55
"""Least share of each scan that marks must tell before it is believed that nothing is in common."""
RIVAL = 0.5
"""Another pose with this share of the best one's marks makes both doubtful: paint repeats."""
APART_MM = 3.0
"""Points of both scans are the same surface where they lie this close."""
REACH_MM = 100.0
"""Distance from the marks up to which a pose has to be true."""
AGREEING = 0.85
"""Least share of what A should see of B that is there."""
BLOCK = 4
"""Points of a coarse cloud a side of a patch."""
HELD, MAX_OUTLIERS, MAX_FRONT, MAX_UNMET = 5.0, 0.05, 0.02, 0.1
"""Bounds of a pose that shape alone tells, as in ``appliance.measure.overlap.pair``."""
LOOKED_AT = 1_500
"""Points that the share is told from."""


@dataclass(slots=True, eq=False)
class CoarseView:
    """A scan as it is compared under water. What takes time is made when it is first asked for."""

    points_mm: NDArray[np.float32]
    """(gh, gw, 3) in the left camera's frame, every ``stride_px``-th pixel; NaN where there is none."""
    sigma_mm: NDArray[np.float32]
    stride_px: int
    pictures: tuple[NDArray[np.uint8], NDArray[np.uint8]]
    """Bright picture and another one of the same light, small, (h, w)."""
    reduced: float
    """Pixels of the full picture per pixel of these."""
    projection: Projection
    """Projection of the full picture."""
    _marks: tuple[PictureMarks, ...] = ()
    """Features of the pictures that were searched so far."""
    _features: Features | None = None
    _shape: Prepared | None = None
    _surface: tuple[Array, Array] | None = None
    _told: float | None = None

    def search(self) -> Iterator[None]:
        """Get the features ready, piece by piece: a picture takes 0.1 s."""
        for picture in self.pictures[len(self._marks) :]:
            self._marks = (*self._marks, marks_of(picture, MOST_MARKS))
            yield None
        self.features()

    def features(self) -> Features:
        """Return the marks that both pictures have, with the points below."""
        if self._features is None:
            one, other = (
                *self._marks,
                *(marks_of(picture, MOST_MARKS) for picture in self.pictures[len(self._marks) :]),
            )
            uv_px = (one.uv_px + 0.5) * self.reduced - 0.5
            points = points_below(self.points_mm, uv_px / self.stride_px)
            kept = np.flatnonzero(
                np.isfinite(points[:, 2]) & _again(one.uv_px, one.descriptors, other.uv_px, other.descriptors)
            )
            kept = kept[np.argsort(-one.strength[kept])][:MOST_MARKS]
            self._features = Features(points[kept], one.descriptors[kept], one.strength[kept])
        return self._features

    def shape(self) -> Prepared:
        """Return the coarse cloud as patches without paint."""
        if self._shape is None:
            nothing = np.zeros(self.points_mm.shape[:2], np.uint8)
            cloud = OrganisedCloud(self.points_mm, self.sigma_mm, self.sigma_mm, self.sigma_mm, nothing)
            of_grid = replace(
                self.projection, terms=self.projection.terms / self.stride_px, size_px=self.points_mm.shape[:2]
            )
            patches = patches_of(cloud, of_grid, BLOCK)
            unknown = np.full(patches.sigma_mm.shape, np.nan)
            self._shape = Prepared(patches, Paint(unknown, np.full((*unknown.shape, 3), np.nan), unknown))
        return self._shape

    def surface(self) -> tuple[Array, Array]:
        """Return points (n, 3) of the coarse cloud, mm, and the unit normals (n, 3) there, towards the camera."""
        if self._surface is None:
            p = self.points_mm.astype(np.float64)
            across, down = np.full_like(p, np.nan), np.full_like(p, np.nan)
            across[:, 1:-1], down[1:-1] = p[:, 2:] - p[:, :-2], p[2:] - p[:-2]
            normal = np.cross(across, down)
            normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
            normal *= -np.sign((normal * p).sum(-1, keepdims=True))
            whole = np.isfinite(normal).all(-1)
            self._surface = p[whole], normal[whole]
        return self._surface

    def faintest(self) -> float:
        """Return the grey value of the bright picture that all but a twentieth of the points had."""
        valid = np.isfinite(self.points_mm[..., 2])
        picture = self.pictures[0]
        row, column = (np.nonzero(valid)[k] * self.stride_px / self.reduced for k in (0, 1))
        h, w = picture.shape
        seen = picture[np.minimum(row.astype(int), h - 1), np.minimum(column.astype(int), w - 1)]
        return float(np.percentile(seen, 5.0)) if len(seen) else 0.0

    def told(self) -> float:
        """Return the share of the points that have marks around them which would be known again: each is there once."""
        if self._told is None:
            self._told = self._marked()
        return self._told

    def _marked(self) -> float:
        valid = np.isfinite(self.points_mm[..., 2])
        if not valid.any():
            return 0.0
        step = np.linalg.norm(self.points_mm[:, 1:] - self.points_mm[:, :-1], axis=-1)
        known = step[np.isfinite(step)]
        side = 2 * round(AROUND_MM / max(float(np.median(known)), 0.1)) + 1 if known.size else 3
        pixels = self.projection.pixels(self.features().points_mm[_single(self.features())]) / self.stride_px
        count = np.zeros(valid.shape, np.float32)
        h, w = valid.shape
        at = np.rint(pixels).astype(int)
        at = at[(at[:, 0] >= 0) & (at[:, 1] >= 0) & (at[:, 0] < w) & (at[:, 1] < h)]
        np.add.at(count, (at[:, 1], at[:, 0]), 1.0)
        around = cv2.boxFilter(count, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
        return float(np.count_nonzero(valid & (around > ENOUGH_AROUND - 0.5)) / np.count_nonzero(valid))


def coarse_view(
    cloud: Cloud, stride_px: int, bright: NDArray[np.uint8], others: NDArray[np.uint8], projection: Projection
) -> CoarseView:
    """Keep what a scan is compared by.

    ``cloud``: every ``stride_px``-th pixel's point; ``bright`` (h, w) uint8; ``others`` (n, h, w): frames whose mean is
    lit like it. Nothing of the arguments is kept but copies.
    """
    h, w = bright.shape
    gh, gw = -(-h // stride_px), -(-w // stride_px)
    row, column = np.divmod(cloud.pixel.astype(np.int64), w)
    points = np.full((gh, gw, 3), np.nan, np.float32)
    sigma = np.full((gh, gw), np.nan, np.float32)
    points[row // stride_px, column // stride_px] = cloud.points_mm
    sigma[row // stride_px, column // stride_px] = cloud.sigma_mm
    reduced = max(1.0, w / WORKING_WIDTH_PX)
    small = [_small(frame, reduced) for frame in (bright, *others)]
    mean = np.rint(np.mean(small[1:], axis=0)).astype(np.uint8)
    return CoarseView(points, sigma, stride_px, (small[0], mean), reduced, projection)


def compare(a: CoarseView, b: CoarseView) -> Iterator[Overlap | None]:
    """Find how much of ``b`` lies on ``a``; yields ``None`` after each piece of work, at most some 0.1 s, and the
    answer last."""
    yield from a.search()
    yield None
    yield from b.search()
    yield None
    guesses = guess_by_features(a.features(), b.features())
    if guesses:
        yield _by_features(a, b, guesses)
        return
    yield None
    if min(a.told(), b.told()) >= TOLD:
        yield NO_OVERLAP
        return
    yield from _by_shape(a, b)


def _by_features(a: CoarseView, b: CoarseView, guesses: list[Guess]) -> Overlap:
    best, *others = guesses
    if any(other.support >= RIVAL * best.support for other in others):
        return UNKNOWN
    # Marks along one line leave a turn about it free.
    if turn_error_mm(in_common(a.features(), b.features(), best.pose), REACH_MM) > 0.5 * APART_MM:
        return UNKNOWN
    return share_on(a, b, best.pose)


def _by_shape(a: CoarseView, b: CoarseView) -> Iterator[Overlap | None]:
    guesses = guess_by_shape(a.shape(), b.shape(), Rigid(np.eye(3), _middle(a) - _middle(b)), most=3)
    yield None
    fits = []
    for guess in guesses:
        fit = refine(a.shape(), b.shape(), guess.pose, gate_mm=4.0, with_paint=False)
        if fit is not None and fit.outliers < MAX_OUTLIERS and fit.front < MAX_FRONT and fit.unmet < MAX_UNMET:
            fits.append(fit)
        yield None
    # One that slides, beside one that is held, explains as well what is seen: then neither is told.
    if len(fits) == 1 and fits[0].held.min() >= HELD:
        yield share_on(a, b, fits[0].pose)
    else:
        yield UNKNOWN


def share_on(a: CoarseView, b: CoarseView, pose: Rigid) -> Overlap:
    """Return the share of B's points that lie on A's surface with B at ``pose`` in A's frame; unknown where the
    surfaces contradict each other."""
    points = b.points_mm[np.isfinite(b.points_mm[..., 2])].astype(np.float64)
    x = pose.of(points[:: max(1, len(points) // LOOKED_AT)])
    nearest = _distances(a, x)
    on = nearest < APART_MM
    met = np.isfinite(nearest)
    if not len(x) or np.count_nonzero(on) < AGREEING * np.count_nonzero(met):
        return UNKNOWN
    return Overlap(float(np.count_nonzero(on) / len(x)))


def _distances(a: CoarseView, x: Array) -> Array:
    """Return the distance (n,) of points ``x`` (n, 3) in A's frame from A's nearest point where A's camera sees them,
    mm; infinite where A has none there."""
    h, w = a.points_mm.shape[:2]
    with np.errstate(invalid="ignore"):
        cell = np.nan_to_num(np.rint(a.projection.pixels(x) / a.stride_px), nan=-9.0, posinf=-9.0, neginf=-9.0)
    cell = np.clip(cell, -9, max(h, w) + 9).astype(int)
    nearest = np.full(len(x), np.inf)
    for dv in (-1, 0, 1):
        for du in (-1, 0, 1):
            column, row = cell[:, 0] + du, cell[:, 1] + dv
            inside = (column >= 0) & (row >= 0) & (column < w) & (row < h)
            at = a.points_mm[np.where(inside, row, 0), np.where(inside, column, 0)]
            away = np.linalg.norm(at - x, axis=1)
            nearest = np.fmin(nearest, np.where(inside, away, np.inf))
    return nearest


def _again(
    uv: Array, descriptors: NDArray[np.float32], other_uv: Array, others: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Return which marks (n,) the other picture has, too: noise and what drifts by are not seen twice."""
    if not len(uv) or not len(other_uv):
        return np.zeros(len(uv), bool)
    away = np.hypot(uv[:, None, 0] - other_uv[None, :, 0], uv[:, None, 1] - other_uv[None, :, 1])
    return np.asarray(((away < AGAIN_PX) & (descriptors @ others.T > AGAIN_ALIKE)).any(axis=1))


def _single(features: Features) -> NDArray[np.bool_]:
    """Return which features (n,) no other one resembles: squares of a grid match nothing, since they match too much."""
    alike = features.descriptors @ features.descriptors.T
    away = np.linalg.norm(features.points_mm[:, None] - features.points_mm[None], axis=-1)
    return np.asarray(~((alike > ALIKE) & (away > APART_MM)).any(axis=1))


def _middle(view: CoarseView) -> Array:
    points = view.points_mm[np.isfinite(view.points_mm[..., 2])]
    return np.median(points, axis=0).astype(np.float64) if len(points) else np.zeros(3)


def _small(picture: NDArray[np.uint8], reduced: float) -> NDArray[np.uint8]:
    if reduced == 1.0:
        return picture.copy()
    size = (round(picture.shape[1] / reduced), round(picture.shape[0] / reduced))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
