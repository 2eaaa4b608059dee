"""Test by texture: patches of the left image must lie in the right one where points are projected.

Along the disparity the fringes have placed each point, for any cameras in the description; across it they
have not, and cameras in another pose move the patches. Texture does not see a turn about the axis across the disparity,
which moves patches along it alone. A patch counts where one place is clearly the best by normalised correlation of
images without noise and shading.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.desk.foreign.camera import MAD_TO_SIGMA
from appliance.desk.foreign.phase import Floats

USUAL_WIDTH_PX = 1280
"""Width to which larger images are reduced."""
MOST_HALF_PX, LEAST_HALF_PX = 15, 7
"""Half a patch, less half a pixel, of images of the usual width, and of small ones."""
FINE_PX, COARSE_PX = 1.5, 12.0
"""Standard deviations of the two Gaussians whose difference is the compared texture."""
REACH = 0.06
"""Largest distance at which a patch is searched, over the length of the image across the disparity."""
ALIKE, CLEARLY, SAME_PX = 0.85, 0.08, 4
"""Least correlation of a place, and its least margin over any place farther away than the third number in px."""
MOST_OFFSET_PX = 2.0
"""Largest offset with right camera numbers, in images of the usual width."""
LEAST_FOUND = 40


@dataclass(frozen=True, slots=True)
class Offset:
    """Statistics of the distances, across the disparity, between matched places and their projections."""

    searched: int
    matched: int
    median_px: float
    spread_px: float
    """Robust standard deviation."""
    allowed_px: float

    @classmethod
    def of(cls, offsets_px: NDArray[np.float64], searched: int, allowed_px: float) -> Offset:
        """Return the statistics of single offsets."""
        if not offsets_px.size:
            return cls(searched, 0, 0.0, 0.0, allowed_px)
        median = float(np.median(offsets_px))
        spread = MAD_TO_SIGMA * float(np.median(np.abs(offsets_px - median)))
        return cls(searched, int(offsets_px.size), median, spread, allowed_px)

    @property
    def tells(self) -> bool:
        """True if enough places were matched for a conclusion."""
        return self.matched >= LEAST_FOUND

    @property
    def size_px(self) -> float:
        """The larger one of median and spread."""
        return max(abs(self.median_px), self.spread_px)

    @property
    def fits(self) -> bool:
        """True if it is as small as right camera numbers leave it."""
        return self.tells and self.size_px <= self.allowed_px

    def __str__(self) -> str:
        offset_text = f", {self.median_px:+.1f} ± {self.spread_px:.1f} px aside" if self.tells else ": too few to tell"
        return f"{self.matched} of {self.searched} places are found again{offset_text}"


Textures = tuple[Floats, Floats, int]
"""Texture of the left and the right image, and how many of their pixels are one there."""


def textures_of(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> Textures:
    """Return the textures of two images in even light, reduced to about the usual width."""
    reduced = -(-max(left.shape[1], right.shape[1]) // int(1.5 * USUAL_WIDTH_PX))
    return _texture(left, reduced), _texture(right, reduced), reduced


def texture_offset(textures: Textures, left_px: NDArray[Any], right_px: NDArray[np.float64], down: bool) -> Offset:
    """Return the offset of patches about ``left_px`` (n, 2) from ``right_px``.

    It is ``down`` the image, or along it.
    """
    reduced = textures[2]
    finite = np.isfinite(right_px).all(axis=1)
    places = (np.stack([left_px[finite], right_px[finite]]) + 0.5) / reduced - 0.5
    left, right = (part if down else part.T for part in textures[:2])
    places = places if down else places[..., ::-1]
    half = max(LEAST_HALF_PX, min(MOST_HALF_PX, left.shape[1] // 60))
    reach = round(REACH * right.shape[0])
    searched, offsets_px, side = 0, [], 2 * half + 1
    moved = np.rint(places) - places
    for (x, y), (u, v), rounding_px in zip(*np.rint(places).astype(int), (moved[1] - moved[0])[:, 1], strict=True):
        patch = left[max(0, y - half) : y + half + 1, max(0, x - half) : x + half + 1]
        strip = right[max(0, v - half - reach) : v + half + reach + 1, max(0, u - half) : u + half + 1]
        if min(x, y, u, v - reach) < half or patch.shape != (side, side) or strip.shape != (side + 2 * reach, side):
            continue
        searched += 1
        alike = cv2.matchTemplate(strip, patch, cv2.TM_CCOEFF_NORMED)[:, 0]
        k = int(alike.argmax())
        second_best = max(
            float(part.max(initial=-1.0)) for part in (alike[: max(0, k - SAME_PX)], alike[k + SAME_PX + 1 :])
        )
        if 0 < k < 2 * reach and alike[k] > max(ALIKE, second_best + CLEARLY):
            before, peak, after = alike[k - 1 : k + 2]
            offsets_px.append(k - reach + 0.5 * (before - after) / (before - 2.0 * peak + after) + rounding_px)
    return Offset.of(reduced * np.array(offsets_px), searched, reduced * MOST_OFFSET_PX)


def _texture(image: NDArray[np.uint8], reduced: int) -> Floats:
    size = (image.shape[1] // reduced, image.shape[0] // reduced)
    smaller = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(smaller, (0, 0), FINE_PX) - cv2.GaussianBlur(smaller, (0, 0), COARSE_PX))
