"""Keypoints that two scans may share: SIFT features of the bright image, with the points below them.

Source: D. Lowe, "Distinctive image features from scale-invariant keypoints" (2004). The contrast is equalised first
(CLAHE), since the light decreases towards the image's border.
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
"""Largest number of features per scan."""
WORKING_WIDTH_PX = 800
"""Images are searched at about this width: smaller detail is noise."""
MAX_STEP_MM = 2.0
"""Largest range of depth over the four pixels of a feature: a larger one is a depth discontinuity."""


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Keypoints of one scan with their points."""

    points_mm: Array
    """(n, 3)."""
    descriptors: NDArray[np.float32]
    """(n, 128), square roots of the normalised histograms: their Euclidean distance is Hellinger's (Arandjelović 2012).
    """
    strength: Array


def features_of(cloud: OrganisedCloud, count_limit: int = MOST) -> Features:
    """Return the strongest features of the bright image that have a point below them, in order."""
    factor = max(1, round(cloud.grey.shape[1] / WORKING_WIDTH_PX))
    small = (
        cloud.grey
        if factor == 1
        else cv2.resize(cloud.grey, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
    )
    marks = find_keypoints(np.asarray(small, np.uint8), count_limit)
    points = points_below(cloud.points_mm, (marks.uv_px + 0.5) * factor - 0.5)
    chosen = np.flatnonzero(np.isfinite(points[:, 2]))
    chosen = chosen[np.argsort(-marks.strength[chosen])][:count_limit]
    return Features(points[chosen], marks.descriptors[chosen], marks.strength[chosen])


@dataclass(frozen=True, slots=True, eq=False)
class Keypoints:
    """Keypoints of an image, without points."""

    uv_px: Array
    """(n, 2): column and row."""
    descriptors: NDArray[np.float32]
    """(n, 128), as in ``Features``."""
    strength: Array


def find_keypoints(picture: NDArray[np.uint8], count_limit: int) -> Keypoints:
    """Find some 2 × ``count_limit`` keypoints of an image (h, w) uint8, in no order."""
    even = cv2.createCLAHE(4.0, (8, 8)).apply(picture)
    sift: Any = cv2.SIFT_create  # type: ignore[attr-defined]  # the stubs do not know it
    keypoints, descriptors = sift(nfeatures=2 * count_limit, contrastThreshold=0.02).detectAndCompute(even, None)
    if descriptors is None or not len(keypoints):
        return Keypoints(np.empty((0, 2)), np.empty((0, 128), np.float32), np.empty(0))
    roots = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6)).astype(np.float32)
    return Keypoints(np.array([key.pt for key in keypoints]), roots, np.array([key.response for key in keypoints]))


def points_below(points_mm: NDArray[np.float32], uv: Array) -> Array:
    """Return the points (n, 3) at pixels (n, 2), bilinear; NaN at a gap or a depth discontinuity."""
    h, w = points_mm.shape[:2]
    u0, v0 = np.floor(uv[:, 0]).astype(int), np.floor(uv[:, 1]).astype(int)
    inside = (u0 >= 0) & (v0 >= 0) & (u0 < w - 1) & (v0 < h - 1)
    u, v = np.where(inside, u0, 0), np.where(inside, v0, 0)
    s, t = (uv[:, 0] - u0)[:, None], (uv[:, 1] - v0)[:, None]
    corners = [points_mm[v + dv, u + du].astype(np.float64) for dv in (0, 1) for du in (0, 1)]
    mean = (1 - t) * ((1 - s) * corners[0] + s * corners[1]) + t * ((1 - s) * corners[2] + s * corners[3])
    depth = np.stack([corner[:, 2] for corner in corners])
    with np.errstate(invalid="ignore"):
        continuous = inside & (depth.max(axis=0) - depth.min(axis=0) < MAX_STEP_MM)
    return np.where(continuous[:, None], mean, np.nan)
