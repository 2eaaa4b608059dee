"""Owns decoding: 20 to 24 frames of one camera become pattern coordinates (p, q), modulation and a reason where not.

Frames are worked on in the order of the sequence: the references give the Gray threshold, each Gray image adds one
bit, and the fourth sine image of a direction closes it. So little is left to do after the last frame. Kernels are flat
loops over C-contiguous arrays, float32, one idea each.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.patterns.gray import inverse_gray
from appliance.patterns.sequence import Direction, Kind, PatternSequence

MIN_CONTRAST_DN = 8
"""Bright minus dark below this is shadow: no projector light."""
MIN_MODULATION_DN = 5.0
"""Modulation below this is noise: at 1.6 DN camera noise the phase error would exceed 1/30 of a period."""
MAX_GRAY_DISAGREEMENT = 0.36
"""Distance between phase and the middle of its Gray half period, in periods; ¼ is perfect, ½ is a wrong order."""
SATURATED_DN = 255


class Mask(IntEnum):
    """Why a pixel has no coordinates; the first that applies."""

    VALID = 0
    SHADOW = 1
    SATURATED = 2
    WEAK = 3
    """Too little modulation."""
    CONTRADICTION = 4
    """Gray code and phase disagree: a mixed pixel or something that moved."""
    EDGE = 5
    """At a jump of the coordinates: the pixel sees two surfaces."""


@numba.njit(nogil=True, cache=True)
def _threshold(
    bright: NDArray[np.uint8], dark: NDArray[np.uint8], threshold: NDArray[np.uint8], mask: NDArray[np.uint8]
) -> None:
    for i in range(bright.size):
        b = np.int32(bright[i])
        d = np.int32(dark[i])
        threshold[i] = (b + d + 1) >> 1
        mask[i] = 1 if b - d < MIN_CONTRAST_DN else 0


@numba.njit(nogil=True, cache=True)
def _add_bit(frame: NDArray[np.uint8], threshold: NDArray[np.uint8], code: NDArray[np.uint8]) -> None:
    for i in range(frame.size):
        code[i] = (code[i] << 1) | (1 if frame[i] >= threshold[i] else 0)


@numba.njit(nogil=True, cache=True)
def _close_axis(
    i0: NDArray[np.uint8],
    i1: NDArray[np.uint8],
    i2: NDArray[np.uint8],
    i3: NDArray[np.uint8],
    code: NDArray[np.uint8],
    half_of_code: NDArray[np.int16],
    period_px: np.float32,
    size_px: np.float32,
    coordinate: NDArray[np.float32],
    modulation: NDArray[np.float32],
    mask: NDArray[np.uint8],
) -> None:
    turn_per_rad = np.float32(1.0 / (2.0 * math.pi))
    for i in range(i0.size):
        a = np.float32(i0[i]) - np.float32(i2[i])
        b = np.float32(i3[i]) - np.float32(i1[i])
        m = np.float32(0.5) * math.sqrt(a * a + b * b)
        modulation[i] = min(modulation[i], m)
        # The middle of the Gray half period, in periods, tells the fringe order at any phase.
        middle = np.float32(0.5) * np.float32(half_of_code[code[i]]) + np.float32(0.25)
        turn = math.atan2(b, a) * turn_per_rad
        offset = turn - middle
        offset -= math.floor(offset + np.float32(0.5))
        value = period_px * (middle + offset) - np.float32(0.5)
        coordinate[i] = value
        if mask[i] == 0:
            if max(max(i0[i], i1[i]), max(i2[i], i3[i])) >= SATURATED_DN:
                mask[i] = 2
            elif m < MIN_MODULATION_DN:
                mask[i] = 3
            elif abs(offset) > MAX_GRAY_DISAGREEMENT or value < np.float32(-1.0) or value > size_px:
                mask[i] = 4


@numba.njit(nogil=True, cache=True)
def _mark_edges(
    p: NDArray[np.float32], q: NDArray[np.float32], jump_px: np.float32, bend_px: np.float32, mask: NDArray[np.uint8]
) -> None:
    """Mask pixels where a coordinate jumps or bends too much between neighbours (2-D arrays)."""
    rows, columns = p.shape
    for y in range(rows):
        for x in range(columns):
            if mask[y, x] != 0:
                continue
            bad = False
            left = x > 0 and (mask[y, x - 1] == 0 or mask[y, x - 1] == 5)
            right = x + 1 < columns and mask[y, x + 1] == 0
            up = y > 0 and (mask[y - 1, x] == 0 or mask[y - 1, x] == 5)
            down = y + 1 < rows and mask[y + 1, x] == 0
            c, d = p[y, x], q[y, x]
            if left and (abs(c - p[y, x - 1]) > jump_px or abs(d - q[y, x - 1]) > jump_px):
                bad = True
            if right and (abs(c - p[y, x + 1]) > jump_px or abs(d - q[y, x + 1]) > jump_px):
                bad = True
            if up and (abs(c - p[y - 1, x]) > jump_px or abs(d - q[y - 1, x]) > jump_px):
                bad = True
            if down and (abs(c - p[y + 1, x]) > jump_px or abs(d - q[y + 1, x]) > jump_px):
                bad = True
            if left and right:
                bend_p = abs(p[y, x - 1] - c - c + p[y, x + 1])
                bend_q = abs(q[y, x - 1] - d - d + q[y, x + 1])
                bad = bad or bend_p > bend_px or bend_q > bend_px
            if up and down:
                bend_p = abs(p[y - 1, x] - c - c + p[y + 1, x])
                bend_q = abs(q[y - 1, x] - d - d + q[y + 1, x])
                bad = bad or bend_p > bend_px or bend_q > bend_px
            if bad:
                mask[y, x] = 5


class CameraDecoder:
    """Decodes one camera's sequence as its frames arrive. Buffers are allocated once and reused scan after scan."""

    def __init__(self, sequence: PatternSequence, width_px: int, height_px: int) -> None:
        self._sequence = sequence
        self._shape = (height_px, width_px)
        n = width_px * height_px
        self._threshold = np.empty(n, np.uint8)
        self._code = np.empty(n, np.uint8)
        self.mask = np.empty(self._shape, np.uint8)
        """(h, w) uint8, values of Mask."""
        self.p_px = np.empty(self._shape, np.float32)
        """(h, w) float32: pattern column of each pixel; meaningful where mask is VALID."""
        self.q_px = np.empty(self._shape, np.float32)
        """(h, w) float32: pattern row."""
        self.modulation_dn = np.empty(self._shape, np.float32)
        """(h, w) float32: the smaller modulation of the two directions."""
        self._half = {d: inverse_gray(len(sequence.axis(d).gray)) for d in Direction}
        self._next = 0

    def reset(self) -> None:
        """Expect frame 0 next."""
        self._next = 0

    def push(self, frames: NDArray[np.uint8], index: int) -> None:
        """Work on frame ``index`` of ``frames`` (n, h, w) uint8. Raises ValueError unless frames come as 0, 1, …"""
        if index != self._next:
            raise ValueError(f"frame {index} was pushed; frame {self._next} is next; start again with frame 0")
        pattern = self._sequence.patterns[index]
        self._next = index + 1
        if index == 0:
            self.modulation_dn.fill(np.float32(1e9))
        if index == max(self._sequence.bright, self._sequence.dark):
            bright = frames[self._sequence.bright].reshape(-1)
            dark = frames[self._sequence.dark].reshape(-1)
            _threshold(bright, dark, self._threshold, self.mask.reshape(-1))
        elif pattern.kind is Kind.GRAY:
            if pattern.index == 0:
                self._code.fill(0)
            _add_bit(frames[index].reshape(-1), self._threshold, self._code)
        elif pattern.kind is Kind.SINE and pattern.index == 3:
            axis = self._sequence.axis(pattern.direction)
            s0, s1, s2, s3 = (frames[k].reshape(-1) for k in axis.sine)
            target = self.p_px if pattern.direction is Direction.X else self.q_px
            _close_axis(
                s0,
                s1,
                s2,
                s3,
                self._code,
                self._half[pattern.direction],
                np.float32(pattern.period_px),
                np.float32(pattern.size_px),
                target.reshape(-1),
                self.modulation_dn.reshape(-1),
                self.mask.reshape(-1),
            )

    def finish(self) -> None:
        """Close the scan: mask edges; coordinates are final then. Raises ValueError when frames are missing."""
        if self._next != len(self._sequence):
            raise ValueError(f"{self._next} of {len(self._sequence)} frames were pushed; push all before finishing")
        # A pixel spans about 0.63 pattern px at full resolution, more on a small camera; steep surfaces double it.
        step_px = 1024.0 / self._shape[1]
        noise_px = self._sequence.period_px / 45.0
        _mark_edges(
            self.p_px,
            self.q_px,
            np.float32(4.0 * step_px + 4.0 * noise_px),
            np.float32(0.9 * step_px + 2.5 * noise_px),
            self.mask,
        )
        self._next = 0
