"""Decoding: the frames of one camera become pattern coordinates (p, q), modulation and a mask.

Frames are processed in the order of the sequence. The references give the Gray threshold and the illuminated part of
each row; nothing is computed beyond it. The last Gray image of a direction gives its half periods, for which seven
images are read once and one byte per pixel is written once. The fourth sine image closes the direction: phase, fringe
order, masks and edges, row by row in the cache; a coordinate is written once, after its row has been judged. So little
is left to do after the last frame.

CameraDecoder, DecodedMaps    the decoder, and a copy of its maps
Mask                          why a pixel has no coordinates
find_illuminated_columns      the illuminated part of each row, from the first illuminated pixel to the last
edge_limits_px                the limits of a smooth coordinate

Illuminated parts begin and end at whole blocks, so that vector instructions leave no remainder.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.backscatter import DOUBT, UNSEEN, read_through_backscatter
from appliance.measure.decode.edges import close_axis
from appliance.measure.decode.gray_code import BITS_AT_ONCE, add_bit, number_half_periods, threshold
from appliance.measure.decode.phase import AxisDecoding
from appliance.measure.light.noise import CameraNoise
from appliance.measure.light.patterns import Direction, Kind, PatternSequence

_BLOCK = 64
_NAN = np.float32(np.nan)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _any_illuminated(mask: NDArray[np.uint8]) -> bool:
    """Return True if any element of ``mask`` is 0."""
    minimum = np.uint8(255)
    for x in range(mask.size):
        minimum = min(minimum, mask[x])
    return bool(minimum == np.uint8(0))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _ends(mask: NDArray[np.uint8]) -> tuple[int, int]:
    """Return the start of a row's first block with an unmasked pixel, and the end of the last such block."""
    first, stop = 0, mask.size
    while first < stop and not _any_illuminated(mask[first : first + _BLOCK]):
        first += _BLOCK
    while stop > first and not _any_illuminated(mask[(stop - 1) // _BLOCK * _BLOCK : stop]):
        stop = (stop - 1) // _BLOCK * _BLOCK
    return min(first, stop), stop


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _count(mask: NDArray[np.uint8]) -> int:
    """Return the number of pixels of a row outside of the shadow; 16 bits suffice and keep the loop short."""
    shadow = np.uint16(0)
    for x in range(mask.size):
        shadow = np.uint16(shadow + mask[x])
    return int(mask.size) - int(shadow)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def find_illuminated_columns(
    mask: NDArray[np.uint8], illuminated: NDArray[np.int32], p_px: NDArray[np.float32], q_px: NDArray[np.float32]
) -> int:
    """Write the start and end of each row's illuminated part to ``illuminated`` (h, 2).

    Returns the number of illuminated pixels. ``mask`` (h, w): 1 in the shadow, else 0. Coordinates (h, w) of the scan
    before become NaN outside of the illuminated part; those outside of their own part are NaN already.
    """
    pixels = 0
    for y in range(mask.shape[0]):
        was_first, was_stop = illuminated[y]
        first, stop = _ends(mask[y])
        pixels += _count(mask[y])
        for coordinate in (p_px[y], q_px[y]):
            coordinate[was_first : min(first, was_stop)] = _NAN
            coordinate[max(stop, was_first) : was_stop] = _NAN
        illuminated[y, 0], illuminated[y, 1] = first, stop
    return pixels


MIN_CONTRAST_DN = 8
"""Least difference of bright and dark of an illuminated pixel."""
MIN_MODULATION_DN = 5.0
"""Least modulation: below it, with 1.6 DN camera noise, the phase error would exceed 1/30 of a period."""
MAX_GRAY_DISAGREEMENT = 0.36
"""Largest distance of the phase from the middle of its Gray half period, in periods; ¼ is perfect, ½ a wrong order."""
MAX_VEILED_DISAGREEMENT = 0.46
"""The same along the rows if backscatter is brighter than the object. Then the Gray bits, and less so the phase, follow
the stripes of the backscatter, which lie up to a quarter of a period beside the object's. A row of the wrong order has
a ray gap of millimetres and makes no point."""
MAX_GRAY_BITS = 8
OFFSET_SAMPLES = 1_500
"""Number of pixels whose mean of the sine images is compared with the Gray threshold."""


class Mask(IntEnum):
    """Reason why a pixel has no coordinates; the first that applies."""

    VALID = 0
    SHADOW = 1
    SATURATED = 2
    WEAK = 3
    """Too little modulation."""
    CONTRADICTION = 4
    """Gray code and phase disagree, or backscatter hides the Gray code: a mixed pixel, or motion."""
    EDGE = 5
    """The pixel lies at a jump of the coordinates and sees two surfaces."""


def edge_limits_px(period_px: int, width_px: int, pattern_px: int) -> tuple[np.float32, np.float32]:
    """Return the largest first and second difference of a smooth coordinate between pixels.

    ``width_px``: of the camera; ``pattern_px``: of the pattern.
    """
    # A pixel spans about 0.63 pattern px at full resolution, more on a small camera; steep surfaces double it.
    step_px = float(pattern_px) / width_px
    noise_px = period_px / 45.0
    return np.float32(4.0 * step_px + 4.0 * noise_px), np.float32(0.9 * step_px + 2.5 * noise_px)


@dataclass(slots=True, eq=False)
class DecodedMaps:
    """The maps of one decoded sequence; arrays as those of ``CameraDecoder``."""

    mask: NDArray[np.uint8]
    p_px: NDArray[np.float32]
    q_px: NDArray[np.float32]
    modulation_half_dn: NDArray[np.uint8]
    gray_threshold: NDArray[np.uint8]
    illuminated_columns: NDArray[np.int32]
    illuminated_pixels: int
    offset_per_threshold: float = 1.0
    variance_factor: float = 1.0


class CameraDecoder:
    """Decodes one camera's sequence as its frames arrive; the buffers are reused scan after scan."""

    def __init__(self, sequence: PatternSequence, width_px: int, height_px: int) -> None:
        bits = max(len(sequence.axis(d).gray) for d in Direction)
        if bits > MAX_GRAY_BITS:
            raise ValueError(
                f"a sequence of period {sequence.period_px} px has {bits} Gray images per direction; allowed are up to "
                f"{MAX_GRAY_BITS}: choose a longer period"
            )
        self._sequence = sequence
        self._shape = (height_px, width_px)
        n = width_px * height_px
        self.gray_threshold = np.empty(self._shape, np.uint8)
        """(h, w) uint8: grey value half way between bright and dark, from which on a Gray bit is set."""
        self._threshold = self.gray_threshold.reshape(-1)
        self._half_period = np.empty(n, np.uint8)
        self.illuminated_columns = np.zeros((height_px, 2), np.int32)
        """(h, 2) int32: first column of each row's illuminated part, and the one behind it; beyond, all is SHADOW."""
        self.mask = np.empty(self._shape, np.uint8)
        """(h, w) uint8, values of Mask."""
        self.p_px = np.full(self._shape, np.nan, np.float32)
        """(h, w) float32: pattern column of each pixel; NaN where the mask is not VALID."""
        self.q_px = np.full(self._shape, np.nan, np.float32)
        """(h, w) float32: pattern row."""
        self.modulation_half_dn = np.empty(self._shape, np.uint8)
        """(h, w) uint8: the smaller modulation of the two directions, in half grey values."""
        self.illuminated_pixels = 0
        """Number of pixels that are not in the shadow."""
        self.backscatter_pixels = 0
        """Number of pixels without coordinates since backscatter hides what their Gray code is; their mask is
        CONTRADICTION."""
        self.offset_per_threshold = 1.0
        """Mean of the sine images over ``gray_threshold``: what the projector's response makes of the middle of its
        codes."""
        self.variance_factor = 1.0
        """Variance of the coordinates over that of four steps: what taking a bend out of them multiplied it by."""
        self._next = 0
        self._closed = False
        """True once one direction is closed."""

    def reset(self) -> None:
        """Expect frame 0 next."""
        self._next = 0

    def push(self, frames: NDArray[np.uint8], index: int) -> None:
        """Process frame ``index`` of ``frames`` (n, h, w) uint8; raise ValueError if it is out of order."""
        if index != self._next:
            raise ValueError(f"frame {index} was pushed; frame {self._next} is next; start again with frame 0")
        pattern = self._sequence.patterns[index]
        self._next = index + 1
        if index == max(self._sequence.bright, self._sequence.dark):
            self._begin(frames)
        elif pattern.kind is Kind.GRAY and index == max(self._sequence.axis(pattern.direction).gray):
            self._number(frames, self._sequence.axis(pattern.direction).gray)
        elif index == self._sequence.axis(pattern.direction).last:
            self._close(frames, pattern.direction)

    def _begin(self, frames: NDArray[np.uint8]) -> None:
        bright = frames[self._sequence.bright].reshape(-1)
        dark = frames[self._sequence.dark].reshape(-1)
        threshold(bright, dark, np.uint8(MIN_CONTRAST_DN), self._threshold, self.mask.reshape(-1))
        self._closed = False
        self.backscatter_pixels = 0
        self.illuminated_pixels = int(
            find_illuminated_columns(self.mask, self.illuminated_columns, self.p_px, self.q_px)
        )

    def _number(self, frames: NDArray[np.uint8], gray: tuple[int, ...]) -> None:
        """Compute the half periods from all images at once: each is read once, the result is written once."""
        at_once = gray[:BITS_AT_ONCE]
        # The dark image is a zero bit in illuminated pixels: it fills up to seven images.
        padded = (self._sequence.dark,) * (BITS_AT_ONCE - len(at_once)) + at_once
        a, b, c, d, e, f, g = (frames[k] for k in padded)
        threshold_map, half_period = self._threshold.reshape(self._shape), self._half_period.reshape(self._shape)
        number_half_periods(a, b, c, d, e, f, g, threshold_map, self.illuminated_columns, half_period)
        for k in gray[BITS_AT_ONCE:]:
            add_bit(frames[k].reshape(-1), self._threshold, self._half_period)

    def _close(
        self,
        frames: NDArray[np.uint8],
        direction: Direction,
        max_disagreement: float = MAX_GRAY_DISAGREEMENT,
        min_modulation_dn: float = MIN_MODULATION_DN,
    ) -> None:
        mine = self._sequence.axis(direction)
        s0, s1, s2, s3 = (frames[k] for k in mine.sine)
        half_period = self._half_period.reshape(self._shape)
        axis = AxisDecoding(
            np.float32(self._sequence.period_px),
            np.float32(mine.size_px),
            np.float32(2.0 * min_modulation_dn),
            np.float32(max_disagreement),
            self._closed,
        )
        # A pixel that fails in this direction loses the other direction's coordinate, too.
        jump_px, bend_px = edge_limits_px(self._sequence.period_px, self._shape[1], self._sequence.width_px)
        mine_px, other_px = (self.p_px, self.q_px) if direction is Direction.X else (self.q_px, self.p_px)
        close_axis(
            s0, s1, s2, s3, half_period, self.illuminated_columns, axis, jump_px, bend_px, other_px, mine_px,
            self.modulation_half_dn, self.mask,
        )  # fmt: skip
        if not self._closed:
            self.offset_per_threshold = self._offset_per_threshold(frames, mine.sine)
        self._closed = True

    def _offset_per_threshold(self, frames: NDArray[np.uint8], sine: tuple[int, ...]) -> float:
        """Return ``offset_per_threshold`` from a thousand pixels; 1 if none is valid."""
        step = max(1, int((self.mask.size / OFFSET_SAMPLES) ** 0.5))
        valid = self.mask[::step, ::step] == Mask.VALID
        half_way = int(self.gray_threshold[::step, ::step][valid].sum(dtype=np.int64))
        mean = sum(int(frames[k][::step, ::step][valid].sum(dtype=np.int64)) for k in sine) / len(sine)
        return mean / half_way if half_way else 1.0

    def read_again_through_backscatter(self, frames: NDArray[np.uint8], noise: CameraNoise) -> bool:
        """Decode again, bit by bit, where backscatter is brighter than the object; after the last frame.

        ``frames`` (n, h, w) uint8. Returns False, with the maps unchanged, if that is so nowhere; this takes a
        millisecond. See ``backscatter``.
        """
        columns, doubtful = np.empty((2, *self._shape), np.uint8)
        weakest_dn = read_through_backscatter(self._sequence, frames, self.mask, noise, columns, doubtful)
        if weakest_dn is None:
            return False
        # A camera's ray crosses the stripes of X and stays within one of Y: only bits of X are changed by the water.
        self._begin(frames)
        illuminated = self.mask == np.uint8(Mask.VALID)
        obscured = illuminated & (doubtful == DOUBT)
        self.mask[obscured] = Mask.CONTRADICTION
        self.mask[illuminated & (doubtful == UNSEEN)] = Mask.WEAK
        self.backscatter_pixels = int(np.count_nonzero(obscured))
        for direction in Direction:
            if direction is Direction.X:
                self._half_period[:] = columns.reshape(-1)
                self._close(frames, direction, min_modulation_dn=weakest_dn)
            else:
                self._number(frames, self._sequence.axis(direction).gray)
                self._close(frames, direction, MAX_VEILED_DISAGREEMENT, weakest_dn)
        return True

    def finish(self) -> None:
        """Close the scan: the maps are final. Raises ValueError if frames are missing."""
        if self._next != len(self._sequence):
            raise ValueError(f"{self._next} of {len(self._sequence)} frames were pushed; push all before finishing")
        self._next = 0
        self.variance_factor = 1.0

    def copied(self) -> DecodedMaps:
        """Return a copy of the present maps: 11 bytes per pixel."""
        return DecodedMaps(
            self.mask.copy(),
            self.p_px.copy(),
            self.q_px.copy(),
            self.modulation_half_dn.copy(),
            self.gray_threshold.copy(),
            self.illuminated_columns.copy(),
            self.illuminated_pixels,
            self.offset_per_threshold,
            self.variance_factor,
        )
