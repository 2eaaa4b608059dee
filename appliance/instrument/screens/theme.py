"""Appearance of the screens: colours, type sizes, positions of the keys, colour table of values.

Made for arm's length through a mask: on a display of 5 inches, 800 px wide, capitals of a headline are 5.1 mm high,
those of body type 2.9 mm (at 650 mm, 16 arc minutes are 3.0 mm), and captions, which only name numbers that keep their
place, 2.2 mm. Colours as on dive computers: white is normal, solid yellow a warning, flashing red critical. Brightness,
shape and text distinguish them, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.api import Key


def colour_table() -> NDArray[np.uint8]:
    """Return 256 colours (256, 3) uint8 RGB from dark to bright: viridis without its darkest eighth.

    The steps look even. Lightness alone orders it, so that it can be read in grey and by the colour-blind.
    """
    ramp = np.linspace(32, 255, 256).astype(np.uint8)[np.newaxis, :]
    bgr = np.asarray(cv2.applyColorMap(ramp, cv2.COLORMAP_VIRIDIS), np.uint8)
    return np.ascontiguousarray(bgr[0, :, ::-1])


DESIGN_SIZE_PX = (800, 480)
"""Size for which all positions are laid out; they are scaled to the display's."""


@dataclass(frozen=True, slots=True)
class Colour:
    """Red, green, blue (sRGB) and opacity, 0..1."""

    red: float
    green: float
    blue: float
    alpha: float = 1.0

    def faded(self, alpha: float) -> Colour:
        return Colour(self.red, self.green, self.blue, self.alpha * alpha)

    @property
    def luminance(self) -> float:
        """Relative luminance 0..1 (WCAG 2.2): the colour as a grey value."""
        linear = [
            # sRGB to linear light (IEC 61966-2-1), weighted with the sensitivity of the eye (ITU-R BT.709).
            c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4
            for c in (self.red, self.green, self.blue)
        ]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    def as_tuple(self) -> tuple[float, float, float, float]:
        return self.red, self.green, self.blue, self.alpha


def hex_colour(code: int) -> Colour:
    """Return the colour of a code like ``0x4FD1E0``, opaque."""
    return Colour((code >> 16 & 255) / 255, (code >> 8 & 255) / 255, (code & 255) / 255)


INK = hex_colour(0x05080B)
"""Background, and type on bright ground."""
DEEP = hex_colour(0x0C141B)
PANEL = hex_colour(0x16222C)
LINE = hex_colour(0x2C3E4C)
MUTED = hex_colour(0x9DB2C0)
WHITE = hex_colour(0xF4F8FA)
AQUA = hex_colour(0x3FD0E8)
GREEN = hex_colour(0x5BE38A)
YELLOW = hex_colour(0xFFD21F)
RED = hex_colour(0xFF3B3B)
BLOOD = hex_colour(0xA00A1A)
"""Ground of critical alerts: dark enough for white letters to stand out in grey, too."""

LEAST_CONTRAST = 7.0
"""Least contrast between letters and their ground, by luminance alone (WCAG 2.2, 1.4.6)."""

CAPTION, BODY, TITLE, HEADLINE, HUGE = 24, 30, 40, 54, 84
"""Type sizes in px of the design size. The caption is the smallest."""
REGULAR, BOLD, BLACK = 450, 650, 800
"""Weights of the variable font."""

FLASH_HZ = 1.5
"""Flashes per second: below three, which is the limit for people with photosensitive epilepsy (WCAG 2.3.1)."""


def flash_on(time_s: float) -> bool:
    """Return True in the bright half of a flash at ``time_s``; the first half period is bright."""
    return time_s * FLASH_HZ % 1.0 < 0.5


KEY_CORNERS: Mapping[Key, tuple[bool, bool]] = MappingProxyType(
    {Key.UP: (False, False), Key.DOWN: (False, True), Key.SCAN: (True, False), Key.BACK: (True, True)}
)
"""Corner of each key: whether right, and whether below. Each label touches the edge of the display at its key."""
BAR_PX = 62
"""Height of the upper and the lower bar, which hold the labels."""
LABEL_MAX_PX = 250
LABEL_MIN_PX = 112
