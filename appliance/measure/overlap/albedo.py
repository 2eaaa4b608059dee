"""The texture of a scan: the logarithm of albedo over its patches, without shading.

The light travels with the instrument, so shading stays where the instrument is when the object moves. Registration of
plain grey values would register the lamp. Here the part of log grey that follows from normal and position is regressed
away, with the cosine of Lambert's law as its leading term. The residual, high-passed, is texture and noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure.overlap.patches import Array, Patches

BROAD_MM = 12.0
"""Texture that varies more slowly than this is removed, since illumination varies as slowly."""
ROBUST = 3
"""Rounds of the regression; outlying grey values (glare, shadow) get less weight in each."""
LEAST = 40
"""Fewest patches for a regression of 15 terms."""


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """Texture over the grid of ``Patches``; arrays (gh, gw) and (gh, gw, 3), NaN where it is unknown."""

    value: Array
    """Logarithm of albedo, high-passed: about 0 in the mean."""
    gradient: Array
    """Its gradient along the surface, per mm."""
    noise: Array
    """Standard deviation of ``value`` by the camera's noise."""


def texture_of(patches: Patches, light_mm: Array) -> Texture:
    """Return the texture of ``patches`` that are lit from ``light_mm`` (3,) in the scan's frame."""
    grey = patches.log_grey
    has_grey = np.isfinite(grey)
    value = np.full(grey.shape, np.nan)
    if np.count_nonzero(has_grey) >= LEAST:
        value[has_grey] = _without_shading(patches, has_grey, light_mm)
        value = _high_passed(value, patches)
    return Texture(value, _gradient(value, patches), np.where(np.isfinite(value), patches.grey_noise, np.nan))


def _without_shading(patches: Patches, has_grey: NDArray[np.bool_], light_mm: Array) -> Array:
    n, c = patches.normal[has_grey], patches.centre_mm[has_grey]
    to_light = light_mm - c
    distance = np.linalg.norm(to_light, axis=1)
    cosine = np.maximum((n * to_light).sum(axis=1) / distance, 0.05)
    x, y, z = ((c - c.mean(axis=0)) / 100.0).T
    # Lambert's law and the distance, the decrease of the light over its field, and terms of the normal for gloss and
    # shadow.
    terms = np.stack(
        [np.ones_like(x), np.log(cosine), cosine, cosine**2, np.log(distance), x, y, z, x * x, x * y, y * y,
         n[:, 0], n[:, 1], n[:, 0] * n[:, 1], n[:, 0] ** 2 - n[:, 1] ** 2],
        axis=1,
    )  # fmt: skip
    grey = patches.log_grey[has_grey]
    weight = np.ones(len(grey))
    residual = grey
    for _ in range(ROBUST):
        square = terms.T @ (terms * weight[:, None])
        # On a plane seen from the front most terms are equal: the ridge keeps the solution small there.
        ridge = 1e-6 * np.trace(square) * np.eye(len(square))
        residual = grey - terms @ np.linalg.solve(square + ridge, terms.T @ (weight * grey))
        scale = 1.4826 * float(np.median(np.abs(residual))) + 1e-6
        weight = 1.0 / (1.0 + (residual / (2.0 * scale)) ** 2)
    return np.asarray(residual)


def _high_passed(value: Array, patches: Patches) -> Array:
    """Return ``value`` less its mean over ``BROAD_MM`` around each patch."""
    finite = np.isfinite(value)
    pitch = patch_pitch_mm(patches)
    sigma = max(BROAD_MM / pitch / 2.0, 1.0)
    filled = np.where(finite, value, 0.0)
    # Mean of the finite values: the blurred values over the blurred mask.
    total = cv2.GaussianBlur(filled, (0, 0), sigma)
    share = cv2.GaussianBlur(finite.astype(np.float64), (0, 0), sigma)
    return np.where(finite, value - total / np.maximum(share, 1e-6), np.nan)


def patch_pitch_mm(patches: Patches) -> float:
    """Return the median distance of neighbouring patches, mm."""
    step = np.linalg.norm(patches.centre_mm[:, 1:] - patches.centre_mm[:, :-1], axis=-1)
    finite = step[np.isfinite(step)]
    return float(np.median(finite)) if finite.size else 1.0


def _gradient(value: Array, patches: Patches) -> Array:
    """Return the gradient (gh, gw, 3) along the surface from central differences; NaN without neighbours."""
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
