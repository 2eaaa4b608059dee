"""Owns what one camera's live images say of a scan that would be taken now: too dark, too turbid, other light, moving
too fast.

A scan lives on fringes, that is on contrast that the object shows. Whatever lies before the instrument shows some in
the live views, too: its paint and its outline, and the dark lanes of the live light
(``appliance.instrument.ranging.expected_light``) on anything. The water's glow shows none. So the *detail* of a live
image, in grey values, is about the light that fringes would have; where it is missing, what is left tells darkness from
turbid water. The live light's dark lanes make a *shade* that the projector reaches at no distance
(``appliance.instrument.ranging.expected_light``): an even brightness there is the water's, and strong light is another
lamp's. How fast hands move follows from corners that are followed from one image to the next. What the live light makes
(its lanes, its border) stays where it is in the image and is not followed.

Limits are such that a scan beyond them gives few points or none (``docs/causes.md``); an ordinary scene is far from
them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.measure import FULL_DN, Fault, FaultCode

WIDTH_PX = 200
"""Images are looked at in this width."""
FINE_PX = 5.0
"""Sigma of the blur that takes detail away and leaves the glow."""
DETAIL_SHARE = 0.02
"""Share of the image that must show detail; the laser dots and their streaks are less."""
LEAST_DETAIL_DN = 5.0
"""Fringes of a scan have about this amplitude then, and fewer are decoded the less there is of it."""
LEAST_GLOW_DN, GLOW_OVER_DETAIL = 5.0, 5.0
"""Smooth light from here on, and so many times the detail, is the water's: an object that is merely dark has 2 to 3
times."""
MILKY_SHARE = 0.22
"""The shade's even brightness as a share of the brightest smooth part, from which on the judge of water, too, would
call it dirty."""
EVEN_SHARE, BRIGHT_SHARE = 0.9, 0.1
"""Shares of the shade's pixels that must have so much light: what the water sends back is everywhere, a torch's spot is
not."""
FOREIGN_DN, SPOILING_DN, MOST_DN = 0.5 * FULL_DN, 40.0, 240.0
"""Light of other lamps in the shade, in grey values at no more than the nominal exposure: half of the scale, as the
judge of light has it; the second counts where the picture is saturated as well. At longer exposures both grow with
them, for the water's part does, up to the third."""
SPOILT_SHARE = 0.05
"""Share of the picture's pixels that are saturated, from which on other light is held against it."""
FAST_MM_S = 70.0
"""Speed from which two scans of three keep too few points, although motion is undone."""
CORNERS, LEAST_CORNERS = 60, 6
CORNER_QUALITY, CORNER_DISTANCE_PX = 0.02, 6.0
CORNER_DN = 6.0
"""Contrast of the image that corners are sought in, at least."""
STAYS_PX = 0.35
"""Movement from image to image below which a scene counts as at rest."""
LEAST_AGREE, AGREE = 0.5, 0.3
"""Share of the moving corners that must move alike, and within what part of their way."""
CHANGED_DN, CHANGED_BLUR_PX, LEAST_CHANGED = 2.5, 3.0, 0.02
"""Difference of grey values, blur and least share of the image from which corners are followed: what the live light
makes does not change, and a smaller share is nothing that hands do."""
BACK_PX = 0.5
"""A corner that is followed forth and back must end within this where it began."""
WINDOW_PX, LEVELS = (15, 15), 3


@dataclass(frozen=True, slots=True)
class Shade:
    """Light over the black level where the projector throws none, in grey values."""

    even_dn: float
    """Nearly all of the shade is as bright as this or brighter."""
    bright_dn: float
    """A tenth of it is brighter: the laser dots and their streaks are less."""


@dataclass(frozen=True, slots=True, eq=False)
class Aimed:
    """One live image, looked at."""

    small: NDArray[np.uint8]
    """(h, ``WIDTH_PX``) uint8: reduced."""
    detail_dn: float
    glow_dn: float
    """Height of the brightest smooth part over the black level."""
    shade: Shade | None = None
    """Light where the projector throws none; ``None``: nobody knows where that is."""
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
            known = self.saturated_share < SPOILT_SHARE
            if known and self.shade.even_dn >= max(LEAST_GLOW_DN, MILKY_SHARE * self.glow_dn):
                lit = f"{self.shade.even_dn:.0f} of {self.glow_dn:.0f} DN are the water's"
                return Fault(FaultCode.AIM_TURBID, lit, numbers | {"veil_dn": self.shade.even_dn})
        if self.detail_dn >= LEAST_DETAIL_DN:
            return None
        seen = f"contrasts of {self.detail_dn:.1f} DN in smooth light of {self.glow_dn:.0f} DN"
        shines = self.glow_dn >= max(LEAST_GLOW_DN, GLOW_OVER_DETAIL * self.detail_dn)
        return Fault(FaultCode.AIM_TURBID if shines else FaultCode.AIM_DARK, seen, numbers)

    def _foreign(self, shade: Shade, longer: float) -> bool:
        """Tell whether another lamp takes so much of the scale that the projector's fringes have too little room on it."""
        spoils = self.saturated_share >= SPOILT_SHARE
        return shade.bright_dn >= min((SPOILING_DN if spoils else FOREIGN_DN) * longer, MOST_DN)


def look(image: NDArray[np.uint8], black_dn: float, shade: NDArray[np.bool_] | None = None) -> Aimed:
    """Look at a live image (h, w) uint8 that the live light lights; about 1 ms at full size.

    ``shade`` (h, ``WIDTH_PX``) bool: pixels of the reduced image that this light does not reach.
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
    return Aimed(
        np.asarray(small, np.uint8),
        _upper(cv2.absdiff(light, glow), DETAIL_SHARE),
        _upper(glow, DETAIL_SHARE) - black_dn,
        shaded,
        float(np.count_nonzero(image >= FULL_DN) / image.size),
    )


def moved_px(before: Aimed, after: Aimed) -> float | None:
    """Estimate how far the scene moved between two images, in px of the reduced ones; ``None``: too little can be
    followed.

    The result is 0 where next to nothing changes, or what changes does not move as one.
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
    there, found, _ = cv2.calcOpticalFlowPyrLK(
        before.small, after.small, corners, np.empty_like(corners), winSize=WINDOW_PX, maxLevel=LEVELS
    )
    # Followed back, a corner that was lost, or that slid along an edge, does not come home.
    back, again, _ = cv2.calcOpticalFlowPyrLK(
        after.small, before.small, there, np.empty_like(corners), winSize=WINDOW_PX, maxLevel=LEVELS
    )
    closed = np.linalg.norm((back - corners).reshape(-1, 2), axis=1) < BACK_PX
    good = (found.ravel() == 1) & (again.ravel() == 1) & closed
    if np.count_nonzero(good) < LEAST_CORNERS:
        return None
    ways = (there - corners).reshape(-1, 2)[good]
    moving = ways[np.linalg.norm(ways, axis=1) > STAYS_PX]
    if len(moving) < LEAST_CORNERS:
        return 0.0
    # The median: particles and fish that cross the picture have ways of their own.
    middle = np.median(moving, axis=0)
    way = float(np.linalg.norm(middle))
    alike = np.linalg.norm(moving - middle, axis=1) < max(AGREE * way, STAYS_PX)
    return way if np.count_nonzero(alike) >= LEAST_AGREE * len(moving) else 0.0


def too_fast(speed_mm_s: float) -> Fault | None:
    """Return why a scan at this speed would not pass; ``None``: it may."""
    if speed_mm_s <= FAST_MM_S:
        return None
    return Fault(FaultCode.AIM_FAST, f"{speed_mm_s:.0f} mm/s across the picture", {"speed_mm_s": speed_mm_s})


def _upper(values: NDArray[Any], share: float) -> float:
    """Return the value that ``share`` of all exceed."""
    flat = np.asarray(values, np.float32).ravel()
    k = max(0, min(flat.size - 1, int((1.0 - share) * flat.size)))
    return float(np.partition(flat, k)[k])
