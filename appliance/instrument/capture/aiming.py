"""Checks of one camera's live images: too dark, too turbid, other light, moving too fast for a scan.

A scan needs the contrast of fringes on the object. In the live views the object shows contrast, too: its albedo and its
outline, and the dark lanes of the live light (``appliance.instrument.ranging.expected_light``). Backscatter shows none.
So the *detail* of a live image, in grey values, is about the modulation that fringes would have; if it is missing, the
remaining light distinguishes darkness from turbid water.

The live light's dark lanes make a *shade* that the projector reaches at no distance: an even brightness there is
backscatter, and strong light is another lamp's. The speed of the hands follows from corners that are tracked from one
image to the next. Lanes and border of the live light stay where they are in the image and are not tracked.

A scan beyond the limits gives few points or none (``docs/causes.md``); an ordinary scene is far from them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure import FULL_DN, Fault, FaultCode

WIDTH_PX = 200
"""Width of the reduced image."""
FINE_PX = 5.0
"""Sigma of the blur that removes detail and leaves smooth light."""
DETAIL_SHARE = 0.02
"""Share of the image that must show detail; the laser dots and their streaks have less."""
LEAST_DETAIL_DN = 5.0
"""Least detail for a scan, about the modulation of its fringes."""
LEAST_GLOW_DN, GLOW_OVER_DETAIL = 5.0, 5.0
"""Smooth light counts as backscatter from this grey value and this multiple of the detail.

A dark object has a multiple of 2 to 3.
"""
MILKY_SHARE = 0.22
"""Even brightness of the shade, as a share of the brightest smooth part, from which the water counts as dirty.

About the limit of the judge of water.
"""
EVEN_SHARE, BRIGHT_SHARE = 0.9, 0.1
"""Shares of the shade's pixels for even and for bright light: backscatter is everywhere, a torch's spot is not."""
FOREIGN_DN, SPOILING_DN, MOST_DN = 0.5 * FULL_DN, 40.0, 240.0
"""Limits of ambient light in the shade, in grey values at the nominal exposure.

The first is half of the scale, as for the judge of light; the second holds if the image is saturated as well. At longer
exposures both grow in proportion, as backscatter does, up to the third.
"""
SPOILT_SHARE = 0.05
"""Share of saturated pixels from which the second limit holds."""
FAST_MM_S = 70.0
"""Speed from which two scans of three keep too few points, despite motion compensation."""
CORNERS, LEAST_CORNERS = 60, 6
CORNER_QUALITY, CORNER_DISTANCE_PX = 0.02, 6.0
CORNER_DN = 6.0
"""Least contrast of an image in which corners are searched."""
STAYS_PX = 0.35
"""Displacement between images below which a scene counts as at rest."""
LEAST_AGREE, AGREE = 0.5, 0.3
"""Share of the moving corners that must move alike, and the tolerance as a share of their displacement."""
CHANGED_DN, CHANGED_BLUR_PX, LEAST_CHANGED = 2.5, 3.0, 0.02
"""Difference of grey values, blur, and least share of the image from which corners are tracked.

The pattern of the live light does not change, and hands change a larger share.
"""
BACK_PX = 0.5
"""Largest error of a corner that is tracked forth and back."""
WINDOW_PX, LEVELS = (15, 15), 3


@dataclass(frozen=True, slots=True)
class Shade:
    """Light over the black level where the projector is dark, in grey values."""

    even_dn: float
    """Grey value that nearly all of the shade reaches."""
    bright_dn: float
    """Grey value that a tenth of the shade exceeds; laser dots and their streaks cover less."""


@dataclass(frozen=True, slots=True, eq=False)
class LiveImage:
    """Measures of one live image."""

    small: NDArray[np.uint8]
    """Reduced image, (h, ``WIDTH_PX``) uint8."""
    detail_dn: float
    glow_dn: float
    """Brightest smooth part over the black level."""
    shade: Shade | None = None
    """Light where the projector is dark; ``None``: that region is not known."""
    saturated_share: float = 0.0
    """Share of the pixels that are saturated."""

    def fault(self, longer: float = 1.0) -> Fault | None:
        """Return the reason why a scan in this light would be poor; ``None``: it may be good.

        ``longer``: light of the exposure as a multiple of the nominal one's.
        """
        numbers = {"detail_dn": self.detail_dn, "glow_dn": self.glow_dn}
        if self.shade is not None:
            numbers["shade_dn"] = self.shade.bright_dn
            if self._foreign(self.shade, max(longer, 1.0)):
                return Fault(FaultCode.AIM_LIGHT, f"{self.shade.bright_dn:.0f} DN where the projector is dark", numbers)
            is_unsaturated = self.saturated_share < SPOILT_SHARE
            if is_unsaturated and self.shade.even_dn >= max(LEAST_GLOW_DN, MILKY_SHARE * self.glow_dn):
                turbid_detail = f"{self.shade.even_dn:.0f} of {self.glow_dn:.0f} DN are backscatter"
                return Fault(FaultCode.AIM_TURBID, turbid_detail, numbers | {"veil_dn": self.shade.even_dn})
        if self.detail_dn >= LEAST_DETAIL_DN:
            return None
        detail = f"contrasts of {self.detail_dn:.1f} DN in backscatter of {self.glow_dn:.0f} DN"
        shines = self.glow_dn >= max(LEAST_GLOW_DN, GLOW_OVER_DETAIL * self.detail_dn)
        return Fault(FaultCode.AIM_TURBID if shines else FaultCode.AIM_DARK, detail, numbers)

    def _foreign(self, shade: Shade, longer: float) -> bool:
        """Return True if ambient light leaves the projector's fringes too little of the scale."""
        spoils = self.saturated_share >= SPOILT_SHARE
        return shade.bright_dn >= min((SPOILING_DN if spoils else FOREIGN_DN) * longer, MOST_DN)


def measure_image(image: NDArray[np.uint8], black_dn: float, shade: NDArray[np.bool_] | None = None) -> LiveImage:
    """Measure a live image (h, w) uint8; takes about 1 ms at full size.

    ``shade`` (h, ``WIDTH_PX``) bool: pixels of the reduced image that the live light does not reach.
    """
    height = max(1, round(WIDTH_PX * image.shape[0] / image.shape[1]))
    small = cv2.resize(image, (WIDTH_PX, height), interpolation=cv2.INTER_AREA)
    light = small.astype(np.float32)
    # Reflected at the border: darkness beyond it would look like detail along all four edges.
    glow = cv2.GaussianBlur(light, (0, 0), FINE_PX, borderType=cv2.BORDER_REFLECT)
    shaded = None
    if shade is not None and shade.shape == light.shape:
        dark = light[shade]
        shaded = Shade(_upper(dark, EVEN_SHARE) - black_dn, _upper(dark, BRIGHT_SHARE) - black_dn)
    return LiveImage(
        np.asarray(small, np.uint8),
        _upper(cv2.absdiff(light, glow), DETAIL_SHARE),
        _upper(glow, DETAIL_SHARE) - black_dn,
        shaded,
        float(np.count_nonzero(image >= FULL_DN) / image.size),
    )


def displacement_px(before: LiveImage, after: LiveImage) -> float | None:
    """Estimate the displacement of the scene between two images, in px of the reduced ones.

    ``None``: too few corners can be tracked. 0 where almost nothing changes, or the changes do not move alike.
    """
    change = cv2.GaussianBlur(cv2.absdiff(before.small, after.small).astype(np.float32), (0, 0), CHANGED_BLUR_PX)
    changed = (change > CHANGED_DN).astype(np.uint8)
    if changed.mean() < LEAST_CHANGED:
        return 0.0
    if before.detail_dn < CORNER_DN:
        return None
    corners = cv2.goodFeaturesToTrack(before.small, CORNERS, CORNER_QUALITY, CORNER_DISTANCE_PX, mask=changed)
    if corners is None or len(corners) < LEAST_CORNERS:
        return None
    tracked, is_tracked, _ = cv2.calcOpticalFlowPyrLK(
        before.small, after.small, corners, np.empty_like(corners), winSize=WINDOW_PX, maxLevel=LEVELS
    )
    # A corner that was lost, or that slid along an edge, is not tracked back to its origin.
    back, is_tracked_back, _ = cv2.calcOpticalFlowPyrLK(
        after.small, before.small, tracked, np.empty_like(corners), winSize=WINDOW_PX, maxLevel=LEVELS
    )
    is_closed = np.linalg.norm((back - corners).reshape(-1, 2), axis=1) < BACK_PX
    good = (is_tracked.ravel() == 1) & (is_tracked_back.ravel() == 1) & is_closed
    if np.count_nonzero(good) < LEAST_CORNERS:
        return None
    displacements = (tracked - corners).reshape(-1, 2)[good]
    moving = displacements[np.linalg.norm(displacements, axis=1) > STAYS_PX]
    if len(moving) < LEAST_CORNERS:
        return 0.0
    # The median, since particles and fish move differently.
    middle = np.median(moving, axis=0)
    length = float(np.linalg.norm(middle))
    is_alike = np.linalg.norm(moving - middle, axis=1) < max(AGREE * length, STAYS_PX)
    return length if np.count_nonzero(is_alike) >= LEAST_AGREE * len(moving) else 0.0


def too_fast(speed_mm_s: float) -> Fault | None:
    """Return a fault if a scan would fail at this speed."""
    if speed_mm_s <= FAST_MM_S:
        return None
    return Fault(FaultCode.AIM_FAST, f"{speed_mm_s:.0f} mm/s across the picture", {"speed_mm_s": speed_mm_s})


def _upper(values: NDArray[Any], share: float) -> float:
    """Return the value that ``share`` of all exceed."""
    flat = np.asarray(values, np.float32).ravel()
    k = max(0, min(flat.size - 1, int((1.0 - share) * flat.size)))
    return float(np.partition(flat, k)[k])
