"""Owns the marks that two scans may have in common: SIFT features of the bright image, with the points below them.

Source: D. Lowe, "Distinctive image features from scale-invariant keypoints" (2004); contrast is evened first (CLAHE),
since the light falls off towards the image's border.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure.overlap.patches import Array
from appliance.measure.points.organised import OrganisedCloud

MOST = 2_500
"""Features per scan, the strongest ones."""
WORKING_WIDTH_PX = 800
"""Images are searched at about this width: smaller detail is noise."""
MAX_STEP_MM = 2.0
"""A feature at a step in depth, of more than this over its four pixels, lies on two surfaces."""


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """n features."""

    points_mm: Array
    """(n, 3)."""
    descriptors: NDArray[np.float32]
    """(n, 128), square roots of the normalised histograms: their Euclidean distance is Hellinger's (Arandjelović 2012).
    """
    strength: Array


def features_of(cloud: OrganisedCloud, most: int = MOST) -> Features:
    """Find at most ``most`` features of the bright image that have a point below them."""
    factor = max(1, round(cloud.grey.shape[1] / WORKING_WIDTH_PX))
    small = (
        cloud.grey
        if factor == 1
        else cv2.resize(cloud.grey, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
    )
    marks = marks_of(np.asarray(small, np.uint8), most)
    points = points_below(cloud.points_mm, (marks.uv_px + 0.5) * factor - 0.5)
    kept = np.flatnonzero(np.isfinite(points[:, 2]))
    kept = kept[np.argsort(-marks.strength[kept])][:most]
    return Features(points[kept], marks.descriptors[kept], marks.strength[kept])


@dataclass(frozen=True, slots=True, eq=False)
class PictureMarks:
    """n features of a picture, before anything is known of the points below them."""

    uv_px: Array
    """(n, 2): column and row."""
    descriptors: NDArray[np.float32]
    """(n, 128), as in ``Features``."""
    strength: Array


def marks_of(picture: NDArray[np.uint8], most: int) -> PictureMarks:
    """Find some 2 × ``most`` features of a picture (h, w) uint8, in no order."""
    even = cv2.createCLAHE(4.0, (8, 8)).apply(picture)
    sift: Any = cv2.SIFT_create  # type: ignore[attr-defined]  # the stubs do not know it
    found, descriptors = sift(nfeatures=2 * most, contrastThreshold=0.02).detectAndCompute(even, None)
    if descriptors is None or not len(found):
        return PictureMarks(np.empty((0, 2)), np.empty((0, 128), np.float32), np.empty(0))
    chosen = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6)).astype(np.float32)
    return PictureMarks(np.array([key.pt for key in found]), chosen, np.array([key.response for key in found]))


def points_below(points_mm: NDArray[np.float32], uv: Array) -> Array:
    """Return (n, 3) the points at pixels (n, 2), linear between their four neighbours; NaN where one is missing or far."""
    h, w = points_mm.shape[:2]
    u0, v0 = np.floor(uv[:, 0]).astype(int), np.floor(uv[:, 1]).astype(int)
    inside = (u0 >= 0) & (v0 >= 0) & (u0 < w - 1) & (v0 < h - 1)
    u, v = np.where(inside, u0, 0), np.where(inside, v0, 0)
    s, t = (uv[:, 0] - u0)[:, None], (uv[:, 1] - v0)[:, None]
    corners = [points_mm[v + dv, u + du].astype(np.float64) for dv in (0, 1) for du in (0, 1)]
    mean = (1 - t) * ((1 - s) * corners[0] + s * corners[1]) + t * ((1 - s) * corners[2] + s * corners[3])
    depth = np.stack([one[:, 2] for one in corners])
    with np.errstate(invalid="ignore"):
        whole = inside & (depth.max(axis=0) - depth.min(axis=0) < MAX_STEP_MM)
    return np.where(whole[:, None], mean, np.nan)
