"""Owns the witness of texture: whether patches of the left image lie in the right one where their points are projected.

Along the disparity the fringes have put each point where it is, whatever is said of the cameras; across it nothing has,
and cameras that stand otherwise than said move the patches. A turn about the axis across the disparity moves them along
it alone: texture does not see it. A patch counts where one place is clearly the best by normalised correlation of what
is neither noise nor shading.
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
"""Gaussians between which the texture lies that is compared."""
REACH = 0.06
"""Distance up to which a patch is looked for, over the image's length across the disparity."""
ALIKE, CLEARLY, SAME_PX = 0.85, 0.08, 4
"""Least correlation of a place, and by how much it is better than any that lies farther away than so many px."""
MOST_OFFSET_PX = 2.0
"""Offset that right numbers leave, of images of the usual width."""
LEAST_FOUND = 40


@dataclass(frozen=True, slots=True)
class Offset:
    """Places found again, and how far they lie beside where the cameras' numbers put them, across the disparity."""

    asked: int
    found: int
    median_px: float
    spread_px: float
    """Robust standard deviation."""
    allowed_px: float

    @classmethod
    def of(cls, offsets_px: NDArray[np.float64], asked: int, allowed_px: float) -> Offset:
        """Return the statistics of single offsets."""
        if not offsets_px.size:
            return cls(asked, 0, 0.0, 0.0, allowed_px)
        median = float(np.median(offsets_px))
        spread = MAD_TO_SIGMA * float(np.median(np.abs(offsets_px - median)))
        return cls(asked, int(offsets_px.size), median, spread, allowed_px)

    @property
    def tells(self) -> bool:
        """True if enough was found to tell anything."""
        return self.found >= LEAST_FOUND

    @property
    def size_px(self) -> float:
        """The larger one of median and spread."""
        return max(abs(self.median_px), self.spread_px)

    @property
    def fits(self) -> bool:
        """True if it is as small as right numbers leave it."""
        return self.tells and self.size_px <= self.allowed_px

    def __str__(self) -> str:
        aside = f", {self.median_px:+.1f} ± {self.spread_px:.1f} px aside" if self.tells else ": too few to tell"
        return f"{self.found} of {self.asked} places are found again{aside}"


Textures = tuple[Floats, Floats, int]
"""Texture of the left and the right image, and how many of their pixels are one there."""


def textures_of(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> Textures:
    """Return what two pictures in even light have of it."""
    reduced = -(-max(left.shape[1], right.shape[1]) // int(1.5 * USUAL_WIDTH_PX))
    return _texture(left, reduced), _texture(right, reduced), reduced


def texture_offset(textures: Textures, left_px: NDArray[Any], right_px: NDArray[np.float64], down: bool) -> Offset:
    """Return how far patches about ``left_px`` (n, 2) lie beside ``right_px``: ``down`` the image, or along it."""
    reduced = textures[2]
    few = np.isfinite(right_px).all(axis=1)
    places = (np.stack([left_px[few], right_px[few]]) + 0.5) / reduced - 0.5
    left, right = (one if down else one.T for one in textures[:2])
    places = places if down else places[..., ::-1]
    half = max(LEAST_HALF_PX, min(MOST_HALF_PX, left.shape[1] // 60))
    reach = round(REACH * right.shape[0])
    asked, found, side = 0, [], 2 * half + 1
    moved = np.rint(places) - places
    for (x, y), (u, v), beside in zip(*np.rint(places).astype(int), (moved[1] - moved[0])[:, 1], strict=True):
        patch = left[max(0, y - half) : y + half + 1, max(0, x - half) : x + half + 1]
        strip = right[max(0, v - half - reach) : v + half + reach + 1, max(0, u - half) : u + half + 1]
        if min(x, y, u, v - reach) < half or patch.shape != (side, side) or strip.shape != (side + 2 * reach, side):
            continue
        asked += 1
        alike = cv2.matchTemplate(strip, patch, cv2.TM_CCOEFF_NORMED)[:, 0]
        k = int(alike.argmax())
        other = max(float(one.max(initial=-1.0)) for one in (alike[: max(0, k - SAME_PX)], alike[k + SAME_PX + 1 :]))
        if 0 < k < 2 * reach and alike[k] > max(ALIKE, other + CLEARLY):
            before, here, after = alike[k - 1 : k + 2]
            found.append(k - reach + 0.5 * (before - after) / (before - 2.0 * here + after) + beside)
    return Offset.of(reduced * np.array(found), asked, reduced * MOST_OFFSET_PX)


def _texture(image: NDArray[np.uint8], reduced: int) -> Floats:
    size = (image.shape[1] // reduced, image.shape[0] // reduced)
    few = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(few, (0, 0), FINE_PX) - cv2.GaussianBlur(few, (0, 0), COARSE_PX))
