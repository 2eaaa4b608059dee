"""The projector of the world ``outside``: bit planes, an LED that warms, a hot spot, and a curved focus.

A digital micromirror device shows a grey as a row of flashes: each bit of the linear level is lit for a time in
proportion to its weight, long bits are split and spread over the frame, and the whole is repeated within it (L. J.
Hornbeck, Digital Light Processing for high-brightness, high-resolution applications, Proc. SPIE 3013 (1997) 27). An
exposure of a part of a frame contains some bits more than others.
"""

# Symbols:
#   level     0..1023, the linear light of a code in PLANES bits; lit_s (PLANES,) time of each bit in an exposure
#   x, y      place in the pattern against its middle, in widths of it
#   σ         Gaussian sigma of defocus, projector px

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hw_sim.optics.projector import BLACK, FOCUS_WAY_MM, SPREAD_FAR_PX, Light, LightSlice, defocus_px
from hw_sim.ranges import Range, drawn_strengths

Array = NDArray[np.float64]

PLANES = 10
PIECE_BITS = 6
"""Bits above this one are split into pieces of its length."""
FRAME_S = 1.0 / 60.0
SOFTEST_PX = 2.0 * SPREAD_FAR_PX
"""The sigma of the softest light that ``soften`` mixes in; softness counts its square as 1."""
REFERENCE_NM, REFERENCE_C = 530.0, 25.0
"""Peak of the LED's data sheet, and the temperature of its board there."""
WATER_PER_NM = 4.1e-5
"""Dispersion of water in the green, fall of the index per nm: X. Quan, E. S. Fry, Appl. Opt. 34 (1995) 3477."""
LAMP_RISE_K = 21.0
"""Steady temperature of the lit projector's board above the water: 34 W through its conductance to the shell."""
RANGES = {
    "cycles": Range(1.0, 4.0, "estimate: colour or grey cycles in a frame of 60 Hz; the DLPC350's guide (TI DLPU010) describes pattern and video modes"),
    "order": Range(0.0, 1e6, "the controller's own and not published: any permutation"),
    "dark_part": Range(0.02, 0.10, "estimate: reset and settling of the mirrors, LED blanking"),
    "frame_rms": Range(0.001, 0.004, "estimate: ripple and current noise of LED drivers, frame to frame"),
    "droop": Range(0.003, 0.02, "estimate: −0.1 to −0.3 %/K over 3 to 7 K of junction; that green InGaN fades as it warms: Schubert, Light-Emitting Diodes (2006)"),
    "droop_s": Range(0.2, 2.0, "estimate: thermal time constant of an LED on its board"),
    "hot_spot": Range(0.25, 0.45, "small projectors: 27 to 65 % less in the worst corner (picoprojector.org, 2010, three measured); a DLP projector's specification: 27 %, at most 40 %"),
    "hot_x": Range(-0.2, 0.2, "estimate: offset optics, brightest place off the middle, in widths"),
    "hot_y": Range(-0.2, 0.15, "estimate: offset optics, brightest place off the middle, in widths"),
    "hot_width": Range(0.22, 0.35, "estimate: the spot falls to half within a third of the width"),
    "focus_bend_mm": Range(-40.0, 40.0, "estimate: Petzval curvature of a 17 mm f/2.8 projection lens, in water at 0.5 m"),
    "focus_tilt_x_mm": Range(-15.0, 15.0, "estimate: chip tilted by 0.1° against the lens (Scheimpflug)"),
    "focus_tilt_y_mm": Range(-15.0, 15.0, "estimate: chip tilted by 0.1° against the lens (Scheimpflug)"),
    "led_shift_nm": Range(-10.0, 10.0, "green LEDs on sale: peak 520 (Luminus PT-39), 521 (Broadcom ASMT-QTB4, dominant 525 to 537) and 527 nm (Luminus SST-10-G); 536 nm in a FRAMOS report"),
    "led_width_nm": Range(25.0, 38.0, "partly estimate: full width at half maximum 32 nm (lamp of a FRAMOS report after EMVA 1288) and 35 nm (LuckyLight S150PGC); the ends are estimates"),
    "led_nm_per_k": Range(0.02, 0.06, "estimate: the peak grows longer as it warms (Luminus, of its SST-10-G), by how much was not found"),
}  # fmt: skip
"""Ranges of the family ``projector``; ``cycles`` and ``order`` are rounded."""


@dataclass(frozen=True, slots=True)
class LightEngine:
    """The strengths of projector effects in time, space and colour. Raises ValueError for wrong numbers."""

    cycles: int = 0
    """Number of times that all bit planes are shown in a frame; 0: the light is constant during a frame."""
    order: int = 0
    """Seed of the order of the pieces."""
    dark_part: float = 0.0
    """Share of a frame, at its end, in which the LED is off."""
    frame_rms: float = 0.0
    """Standard deviation of a frame's brightness, as a share."""
    droop: float = 0.0
    """Relative loss of brightness as the LED warms in a sequence."""
    droop_s: float = 1.0
    """Time constant of that loss."""
    hot_spot: float = 0.0
    """Relative loss of light far from the brightest place. 0: the cos⁴ law of the ordinary world."""
    hot_x: float = 0.0
    hot_y: float = 0.0
    """The brightest place, in widths of the pattern from its middle."""
    hot_width: float = 0.3
    """Gaussian sigma of the spot, in widths."""
    focus_bend_mm: float = 0.0
    """Distance of the focus in the corners beyond that in the middle; it grows with the square of the field."""
    focus_tilt_x_mm: float = 0.0
    focus_tilt_y_mm: float = 0.0
    """Distance of the focus at the right, or lower, edge beyond that in the middle."""
    led_shift_nm: float = 0.0
    """Peak of the LED on a board of ``REFERENCE_C``, against ``REFERENCE_NM``."""
    led_width_nm: float = 0.0
    """Full width at half maximum."""
    led_nm_per_k: float = 0.0
    """Shift of the peak as the board warms."""

    def __post_init__(self) -> None:
        for name, (lowest, highest) in _LIMITS.items():
            value = getattr(self, name)
            if not lowest <= value <= highest:
                raise ValueError(f"projector: {name} = {value}; allowed are {lowest:g}..{highest:g}")

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> LightEngine:
        """Return strengths drawn from ``RANGES``."""
        values = drawn_strengths(RANGES, rng)
        cycles, order = round(values.pop("cycles")), round(values.pop("order"))
        return cls(cycles, order, **values)

    # ------------------------------------------------------------------------------------------ time

    def pieces(self) -> tuple[NDArray[np.int64], Array]:
        """Return the bit of each flash of a cycle, in order, and its end as a share of the cycle's light time."""
        bits = np.concatenate([np.full(max(1, 2 ** (b - PIECE_BITS)), b) for b in range(PLANES)])
        bits = np.random.default_rng([self.order, 3]).permutation(bits)
        lengths = np.minimum(2.0**bits, 2.0**PIECE_BITS)
        ends = np.cumsum(lengths)
        return bits, ends / ends[-1]

    def lit_s(self, begin_s: float, end_s: float, frame_s: float = FRAME_S) -> Array:
        """Return the time (PLANES,), s, of the mirrors of each bit between two times after a vertical blank."""
        bits, ends = self.pieces()
        starts = np.concatenate([[0.0], ends[:-1]])
        cycle_s = frame_s * (1.0 - self.dark_part) / self.cycles
        plane_s = np.zeros(PLANES)
        for frame in range(math.floor(begin_s / frame_s), math.ceil(end_s / frame_s)):
            for cycle in range(self.cycles):
                at_s = frame * frame_s + cycle * cycle_s
                seconds = np.minimum(end_s, at_s + ends * cycle_s) - np.maximum(begin_s, at_s + starts * cycle_s)
                plane_s += np.bincount(bits, np.maximum(seconds, 0.0), PLANES)
        return plane_s

    def table_s(self, response: Light, begin_s: float, end_s: float, frame_s: float = FRAME_S) -> Light:
        """Return each code's light, (256,) float32 in seconds of white, between two times after a vertical blank.

        ``response`` is the light of a whole frame; a whole frame gives it, in steps of a bit plane.
        """
        if self.cycles == 0:
            return np.asarray(response * np.float32(end_s - begin_s), np.float32)
        levels = np.rint((response.astype(np.float64) - BLACK) / (1.0 - BLACK) * (2**PLANES - 1)).astype(np.int64)
        on = (levels[:, None] >> np.arange(PLANES)) & 1
        # While it is on, the LED is brighter by its off time, so that a frame of white does not change.
        light = (1.0 - BLACK) / (1.0 - self.dark_part) * (on @ self.lit_s(begin_s, end_s, frame_s))
        return np.asarray(light + BLACK * (end_s - begin_s), np.float32)

    def brightness(self, frame: int, lit_for_s: float, seed: int) -> float:
        """Return the relative brightness of a frame, ``lit_for_s`` after the lamp was switched on."""
        deviate = float(np.random.default_rng([seed, 33, frame % 2**31]).standard_normal()) if self.frame_rms else 0.0
        warmed = 1.0 - math.exp(-max(lit_for_s, 0.0) / self.droop_s)
        return (1.0 + self.frame_rms * deviate) * (1.0 - self.droop * warmed)

    # ------------------------------------------------------------------------------------------ space

    def field(self, uv_px: Array, width_px: float, height_px: float) -> Array:
        """Return the relative brightness at pattern coordinates (..., 2); 1 in the middle of the pattern."""
        x, y = (uv_px[..., 0] - 0.5 * (width_px - 1.0)) / width_px, (uv_px[..., 1] - 0.5 * (height_px - 1.0)) / width_px

        def bright(x: Array, y: Array) -> Array:
            off = ((x - self.hot_x) ** 2 + (y - self.hot_y) ** 2) / (2.0 * self.hot_width**2)
            return np.asarray(1.0 - self.hot_spot + self.hot_spot * np.exp(-off))

        return bright(x, y) / bright(np.zeros(1), np.zeros(1))

    def softness(
        self, uv_px: Array, way_mm: Array, depth_mm: float, size_px: tuple[float, float], spread: float
    ) -> Array:
        """Return the softness 0..1 of light at pattern coordinates (n, 2) after paths (n,) mm.

        It is the variance of the defocus by a thin lens, over ``SOFTEST_PX`` squared. ``spread``: dn/n of the LED's
        spectrum, one standard deviation.
        """
        width, height = size_px
        x, y = (
            (uv_px[:, 0] - 0.5 * (width - 1.0)) / (0.5 * width),
            (uv_px[:, 1] - 0.5 * (height - 1.0)) / (0.5 * height),
        )
        corner = 1.0 + (height / width) ** 2
        bend = self.focus_bend_mm * (x**2 + (height / width * y) ** 2) / corner
        focus = FOCUS_WAY_MM + bend + self.focus_tilt_x_mm * x + self.focus_tilt_y_mm * y
        blur_px = defocus_px(way_mm, depth_mm, focus)
        # Each colour leaves the port at another angle: δu = r δn/n for the path in water.
        colour_px = spread * 0.5 * width * np.hypot(x, height / width * y) * way_mm / (way_mm + depth_mm)
        return np.asarray(np.minimum((blur_px**2 + colour_px**2) / SOFTEST_PX**2, 1.0))

    # ------------------------------------------------------------------------------------------ colour

    def index_spread(self, index: float) -> float:
        """Return dn/n of water of that index over one standard deviation of the LED's spectrum."""
        return WATER_PER_NM * self.led_width_nm / 2.355 / index

    def spectrum(self, water_c: float) -> tuple[Array, Array]:
        """Return wavelengths in nm and their shares of the light, of the warm LED in water of that temperature."""
        peak = REFERENCE_NM + self.led_shift_nm + self.led_nm_per_k * (water_c + LAMP_RISE_K - REFERENCE_C)
        offsets = np.linspace(-2.5, 2.5, 21)
        shares = np.exp(-0.5 * offsets**2)
        return peak + offsets * self.led_width_nm / 2.355, shares / shares.sum()


_LIMITS = {
    "cycles": (0, 16), "order": (0, 2**31), "dark_part": (0.0, 0.5), "frame_rms": (0.0, 0.1), "droop": (0.0, 0.5),
    "droop_s": (0.01, 100.0), "hot_spot": (0.0, 0.9), "hot_x": (-0.5, 0.5), "hot_y": (-0.5, 0.5), "hot_width": (0.1, 2.0),
    "focus_bend_mm": (-100.0, 100.0), "focus_tilt_x_mm": (-100.0, 100.0), "focus_tilt_y_mm": (-100.0, 100.0),
    "led_shift_nm": (-30.0, 30.0), "led_width_nm": (0.0, 60.0), "led_nm_per_k": (0.0, 0.2),
}  # fmt: skip


def sapphire_index(wavelength_nm: float) -> float:
    """Return the ordinary index of sapphire by three Sellmeier terms.

    I. H. Malitson and M. J. Dodge, J. Opt. Soc. Am. 62 (1972) 1405, as printed by M. J. Dodge, Handbook of Laser
    Science and Technology IV (CRC, 1986) 30.
    """
    square = (wavelength_nm / 1000.0) ** 2
    # n² − 1 = Σ A λ² / (λ² − B²), λ in µm.
    terms = ((1.4313493, 0.0726631), (0.65054713, 0.1193242), (5.3414021, 18.028251))
    return math.sqrt(1.0 + sum(a * square / (square - b * b) for a, b in terms))


def flashed_between(
    engine: LightEngine,
    slices: tuple[LightSlice, ...],
    begin_s: float,
    end_s: float,
    table: Light,
    frame: int,
    lit_for_s: float,
    seed: int,
) -> Light | None:
    """Return the same as ``projector.light_between``, of flashing mirrors.

    ``frame``: number of the first slice's frame, which began ``lit_for_s`` after the lamp was switched on.
    """
    total: Light | None = None
    at_s = 0.0
    for number, part in enumerate(slices):
        first_s, last_s = max(begin_s, at_s), min(end_s, at_s + part.duration_s)
        if last_s > first_s:
            since_s = part.since_blank_s - at_s
            codes = engine.table_s(table, since_s + first_s, since_s + last_s, part.frame_s)
            codes = codes * np.float32(engine.brightness(frame + number, lit_for_s + first_s, seed))
            light = cv2.LUT(np.ascontiguousarray(part.image), codes)
            total = np.asarray(light if total is None else total + light, np.float32)
        at_s += part.duration_s
    return total
