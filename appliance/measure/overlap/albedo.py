"""Owns what of a scan's grey values is paint: the logarithm of albedo over the patches, without what lighting makes of
shape.

The light travels with the instrument. What its direction and distance do to grey values stays where the instrument is
when the object moves, so whoever registers grey values as they are registers the lamp. Here the part of log grey that
follows from normal and place is regressed away, with the cosine of Lambert's law as its leading term; the rest,
high-passed, is paint and noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure.overlap.patches import Array, Patches

BROAD_MM = 12.0
"""Paint that varies more slowly than this is left out: light does, too."""
ROBUST = 3
"""Rounds of the regression; outlying grey values (glare, shadow) count less in each."""
LEAST = 40
"""Fewest patches that a regression of its 15 terms is made from."""


@dataclass(frozen=True, slots=True, eq=False)
class Paint:
    """Paint over the grid of ``Patches``; arrays (gh, gw) and (gh, gw, 3), NaN where it is not known."""

    value: Array
    """Logarithm of albedo, high-passed: about 0 in the mean."""
    gradient: Array
    """Its gradient along the surface, per mm."""
    noise: Array
    """Standard deviation of ``value`` by the camera's noise."""


def paint_of(patches: Patches, light_mm: Array) -> Paint:
    """Return the paint of ``patches`` that are lit from ``light_mm`` (3,) in the scan's frame."""
    grey = patches.log_grey
    known = np.isfinite(grey)
    value = np.full(grey.shape, np.nan)
    if np.count_nonzero(known) >= LEAST:
        value[known] = _without_shading(patches, known, light_mm)
        value = _high_passed(value, patches)
    return Paint(value, _gradient(value, patches), np.where(np.isfinite(value), patches.grey_noise, np.nan))


def _without_shading(patches: Patches, known: NDArray[np.bool_], light_mm: Array) -> Array:
    n, c = patches.normal[known], patches.centre_mm[known]
    to_light = light_mm - c
    distance = np.linalg.norm(to_light, axis=1)
    cosine = np.maximum((n * to_light).sum(axis=1) / distance, 0.05)
    x, y, z = ((c - c.mean(axis=0)) / 100.0).T
    # Lambert's law and the distance, the fall of the light over its field, and what shape does beyond: gloss, shaded
    # light.
    terms = np.stack(
        [np.ones_like(x), np.log(cosine), cosine, cosine**2, np.log(distance), x, y, z, x * x, x * y, y * y,
         n[:, 0], n[:, 1], n[:, 0] * n[:, 1], n[:, 0] ** 2 - n[:, 1] ** 2],
        axis=1,
    )  # fmt: skip
    grey = patches.log_grey[known]
    weight = np.ones(len(grey))
    left = grey
    for _ in range(ROBUST):
        square = terms.T @ (terms * weight[:, None])
        # A plane seen from the front leaves most terms alike: the ridge keeps the solution small there.
        ridge = 1e-6 * np.trace(square) * np.eye(len(square))
        left = grey - terms @ np.linalg.solve(square + ridge, terms.T @ (weight * grey))
        scale = 1.4826 * float(np.median(np.abs(left))) + 1e-6
        weight = 1.0 / (1.0 + (left / (2.0 * scale)) ** 2)
    return np.asarray(left)


def _high_passed(value: Array, patches: Patches) -> Array:
    """Return ``value`` less its mean over ``BROAD_MM`` around each patch."""
    known = np.isfinite(value)
    pitch = patch_pitch_mm(patches)
    sigma = max(BROAD_MM / pitch / 2.0, 1.0)
    filled = np.where(known, value, 0.0)
    # Mean of what is known: the blurred values over the blurred mask.
    total = cv2.GaussianBlur(filled, (0, 0), sigma)
    share = cv2.GaussianBlur(known.astype(np.float64), (0, 0), sigma)
    return np.where(known, value - total / np.maximum(share, 1e-6), np.nan)


def patch_pitch_mm(patches: Patches) -> float:
    """Return the median distance of neighbouring patches, mm."""
    step = np.linalg.norm(patches.centre_mm[:, 1:] - patches.centre_mm[:, :-1], axis=-1)
    known = step[np.isfinite(step)]
    return float(np.median(known)) if known.size else 1.0


def _gradient(value: Array, patches: Patches) -> Array:
    """Return the gradient (gh, gw, 3) along the surface from central differences; NaN where a neighbour is missing."""
    gradient = np.full((*value.shape, 3), np.nan)
    c = patches.centre_mm
    across, down = c[1:-1, 2:] - c[1:-1, :-2], c[2:, 1:-1] - c[:-2, 1:-1]
    by_across, by_down = value[1:-1, 2:] - value[1:-1, :-2], value[2:, 1:-1] - value[:-2, 1:-1]
    # g = α across + β down with g · across = by_across and g · down = by_down: two equations with Gram's matrix.
    aa, ad, dd = (across * across).sum(-1), (across * down).sum(-1), (down * down).sum(-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        det = aa * dd - ad * ad
        alpha, beta = (by_across * dd - by_down * ad) / det, (by_down * aa - by_across * ad) / det
        gradient[1:-1, 1:-1] = alpha[..., None] * across + beta[..., None] * down
    # Over an edge the neighbours lie far apart.
    far = np.maximum(np.sqrt(aa), np.sqrt(dd)) > 6.0 * patch_pitch_mm(patches)
    gradient[1:-1, 1:-1][far] = np.nan
    return gradient
