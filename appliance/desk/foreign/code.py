"""Owns the stripes' numbers: bits of a pixel from the images of a code, and the number that they write.

A bit is set where the image is brighter than its inverse; without inverses, brighter than the middle between bright and
dark; without these, brighter than the mean of the sines; without any of them, brighter than the middle between the
pixel's darkest and brightest image of the code.

Stripes finer than the camera's pixels tell nothing, and their images are left out: a Gray code without its finest image
numbers stripes of twice the width. What was left out is said.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.desk.foreign.description import AxisConvention
from appliance.desk.foreign.images import ImageSet
from appliance.desk.foreign.order import Shows

Floats = NDArray[np.float32]

TOLD = 0.25
"""Least share of the full difference at which a pixel tells a stripe from the next."""
WINDOW_PX, LEAST_TOLD, MODULATED = 9, 0.7, 0.1
"""Stripes as wide as a pixel leave a quarter of all pixels below that, and finer ones ever more: in a window of so many
pixels an image is resolved where so large a share tells them apart, and seen at all from the second share on."""
LIT = 0.2
"""Largest difference of a pixel that is asked, over that of the brightest ones."""
LEAST_BITS = 3
LINES_AT_ONCE = 14 * WINDOW_PX
NEARLY_FULL = 0.8
"""Share of the full difference that the two pixels beside a border's own have at least where no other border is near.
"""


@dataclass(frozen=True, slots=True, eq=False)
class CodeBits:
    """The bits of one direction that the camera can tell."""

    packed: NDArray[np.uint8]
    """(n / 8, h, w): ``bits``, eight to a byte."""
    count: int
    contrast: Floats
    """(h, w): the swing that all but a quarter of the bits reach, in grey values; that of the references or the range
    without inverses; 0 where the finest image does not light the pixel: what coarse stripes light by way of the room.
    """
    left_out: tuple[int, int]
    """Number of images that were left out at the beginning and at the end, because their stripes are finer than the
    camera's pixels."""
    borders: Floats | None = None
    """Place between two neighbours along the direction, 0 … 1, at which a bit turns: (h, w − 1), of y (w, h − 1); NaN
    where none does. ``None`` where fringes make the coordinate."""

    @property
    def bits(self) -> NDArray[np.bool_]:
        """(n, h, w) in the order of the images: the stripe is bright.

        Images at either end that the camera cannot resolve are left out.
        """
        return np.unpackbits(self.packed, axis=0, count=self.count).view(np.bool_)

    def numbered(self, axis: AxisConvention, rows: slice) -> tuple[NDArray[np.int32], float]:
        """Return what ``numbered_stripes`` makes of some rows."""
        bits = np.unpackbits(self.packed[:, rows], axis=0, count=self.count).view(np.bool_)
        return numbered_stripes(bits, self.left_out, axis)


def read_bits(images: ImageSet, axis: AxisConvention, sine_mean: Floats | None) -> CodeBits:
    """Return the bits of a direction; ``sine_mean`` (h, w) is the mean of its sines, ``None`` where it has none."""
    gray, inverse = (images.all_of(shows, axis.name) for shows in (Shows.GRAY, Shows.INVERSE))
    bright, dark = images.image(Shows.BRIGHT), images.image(Shows.DARK)
    references = [one for one in (dark, bright) if one is not None]
    turned = axis.name == "y"

    def lines(image: NDArray[Any], part: slice) -> Floats:
        return (image[:, part].T if turned else image[part]).astype(np.float32)

    def signed(part: slice) -> tuple[Floats, Floats | None]:
        """Return the differences from the threshold (n, lines, length) of some lines along the direction, and the swing
        that is known."""
        stack = np.stack([lines(one, part) for one in gray])
        if len(inverse):
            for one, other in zip(stack, inverse, strict=True):
                one -= lines(other, part)
            return stack, None
        if len(references) == 2:
            low, high = (lines(one, part) for one in references)
        elif sine_mean is not None:
            return stack - lines(sine_mean, part), None
        else:
            low, high = stack.min(axis=0), stack.max(axis=0)
        return stack - np.float32(0.5) * (low + high), high - low

    count, length = images.shape[::-1] if turned else images.shape
    parts = [slice(begin, begin + LINES_AT_ONCE) for begin in range(0, count, LINES_AT_ONCE)]
    # Twice over the lines: what is left out is known when all windows were seen, and no stack of floats lives longer
    # than its lines.
    windows = [_windows(signed(part)[0]) for part in parts]
    shares, largest = (
        np.concatenate([one.reshape(len(one), -1) for one in kind], axis=1) for kind in zip(*windows, strict=True)
    )
    left_out = _unresolved(shares[:, largest[0] > LIT * np.quantile(largest, 0.95)], axis.fine_first)
    kept = slice(left_out[0], len(gray) - left_out[1])
    packed = np.empty((-(-(kept.stop - kept.start) // 8), count, length), np.uint8)
    contrast = np.empty((count, length), np.float32)
    borders = np.empty((count, length - 1), np.float32) if sine_mean is None else None
    for part, (told, _) in zip(parts, windows, strict=True):
        stack, swing = signed(part)
        stack = stack[kept]
        packed[:, part] = np.packbits(stack > 0.0, axis=0)
        if swing is None:
            # One bit, and of narrow stripes two, may be in the middle of turning: the others tell how much light there
            # is.
            swing = np.partition(np.abs(stack), len(stack) // 4, axis=0)[len(stack) // 4]
        seen = told[kept][0 if axis.fine_first else -1] >= MODULATED
        contrast[part] = swing * cv2.resize(seen.astype(np.float32), swing.shape[::-1], interpolation=cv2.INTER_NEAREST)
        if borders is not None:
            borders[part] = _borders(stack)
    if turned:
        packed, contrast = np.swapaxes(packed, 1, 2), np.ascontiguousarray(contrast.T)
    return CodeBits(packed, kept.stop - kept.start, contrast, left_out, borders)


def _windows(signed: Floats) -> tuple[Floats, Floats]:
    """Return, by image and window, the share of the pixels that tell a stripe from the next, of differences (n, lines,
    length); and each window's mean largest difference (1, …)."""
    size = np.abs(signed)
    largest = size.max(axis=0)
    grid = tuple(max(1, length // WINDOW_PX) for length in largest.shape[::-1])
    told = [(one > np.float32(TOLD) * largest).astype(np.float32) for one in size]
    means = [cv2.resize(one, grid, interpolation=cv2.INTER_AREA) for one in (*told, largest)]
    return np.stack(means[:-1]), np.stack(means[-1:])


def _unresolved(shares: Floats, fine_first: bool) -> tuple[int, int]:
    """Return how many images at the beginning and at the end have stripes that the camera cannot tell, from what
    ``_windows`` found.

    Windows are asked that stripes four times as wide modulate: coarse ones light the room as well, which tells nothing
    of finer ones.
    """
    ordered = shares[::-1] if fine_first else shares
    count, windows = ordered.shape
    asked = [float(np.mean(one >= MODULATED)) if windows else 0.0 for one in (ordered[0], ordered[0], *ordered[:-2])]
    told = [float(np.mean(one >= LEAST_TOLD)) > 0.5 * among > 0.0 for one, among in zip(ordered, asked, strict=False)]
    finest = max((k for k in range(count) if told[k]), default=-1)
    # Of fewer it is no matter of fineness.
    out = count - 1 - finest if finest + 1 >= LEAST_BITS else 0
    return (out, 0) if fine_first else (0, out)


def _borders(signed: Floats) -> Floats:
    """Return where bits turn between neighbours, from signed differences (n, lines, length); several that do are
    averaged.

    A pixel is the mean over its area: with t the difference over the full one, 1 before the border and −1 behind it,
    the sum of t over pixels on both sides is twice the distance of the border from their middle. Two pixels are asked,
    and four where two on either side are nearly full: what a lens blurs beyond two of them counts then, and another
    border does not.
    """
    full = np.maximum(np.abs(signed).max(axis=0), np.float32(1e-3))
    lines = signed / full
    total = np.zeros((lines.shape[1], lines.shape[2] - 1), np.float32)
    count = np.zeros(total.shape, np.float32)
    for one in lines:
        row, column = np.nonzero((one[:, :-1] > 0.0) != (one[:, 1:] > 0.0))
        here, next_ = one[row, column], one[row, column + 1]
        side = np.where(here > 0.0, np.float32(0.5), np.float32(-0.5))
        place = np.float32(0.5) + side * (here + next_)
        # Two pixels before the border's own and two behind, each with the sign that it has on its side.
        around = [side * one[row, np.clip(column + off, 0, one.shape[1] - 1)] for off in (-2, -1, 2, 3)]
        least = np.minimum(np.minimum(around[0], around[1]), -np.maximum(around[2], around[3]))
        wide = least > np.float32(0.5 * NEARLY_FULL)
        place += np.where(wide, around[1] + around[2], np.float32(0.0))
        total[row, column] += np.clip(place, 0.0, 1.0)
        count[row, column] += 1.0
    with np.errstate(invalid="ignore"):
        return np.asarray(total / count, np.float32)


def stripe_numbers(bits: NDArray[np.bool_], axis: AxisConvention) -> NDArray[np.int32]:
    """Return the number (h, w) int32 of each pixel's stripe that ``bits`` (n, h, w) write by the convention of
    ``axis``."""
    ordered = bits[::-1] if axis.fine_first else bits
    number = np.zeros(bits.shape[1:], np.int32)
    last = np.zeros(bits.shape[1:], np.bool_)
    for bit in ordered:
        lit = ~bit if axis.inverted else bit
        # Gray code: a digit of the number is the image's bit, inverted where the digit before is set.
        last = lit if axis.plain_binary else lit ^ last
        number = 2 * number + last
    return number


def numbered_stripes(
    bits: NDArray[np.bool_], left_out: tuple[int, int], axis: AxisConvention
) -> tuple[NDArray[np.int32], float]:
    """Return the stripes' numbers and their width in px of the pattern.

    Without its last digit a number counts stripes of twice the width: so it is where the finest images were left out,
    and where stripes are finer than half a fringe, which tells the fringe already.
    """
    number = stripe_numbers(bits, axis)
    stripe_px = axis.stripe_px * 2.0 ** left_out[0 if axis.fine_first else 1]
    while axis.periods_px and stripe_px <= 0.2501 * axis.periods_px[axis.numbered]:
        number >>= 1
        stripe_px *= 2.0
    return number, stripe_px
