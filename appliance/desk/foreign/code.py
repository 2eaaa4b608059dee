"""Stripe numbers: the bits of a pixel from the images of a code, and the number that they write.

A bit is set where the image is brighter than its inverse; without inverses, brighter than the middle between bright and
dark; without these, brighter than the mean of the sine frames; without any of them, brighter than the middle between
the pixel's darkest and brightest image of the code.

Images with stripes finer than the camera's pixels are left out: a Gray code without its finest image numbers stripes of
twice the width. The report says how many were left out.
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

DISTINCT = 0.25
"""Least share of the full difference at which a pixel separates a stripe from the next."""
WINDOW_PX, LEAST_DISTINCT_SHARE, MODULATED = 9, 0.7, 0.1
"""Size of a window; share of its pixels with distinct stripes from which an image is resolved, and share from which it is
seen at all. Stripes as wide as a pixel leave a quarter of all pixels below ``DISTINCT``, and finer ones more."""
LEAST_SWING = 0.2
"""Least swing of a window that counts, over that of the brightest ones."""
LEAST_BITS = 3
LINES_AT_ONCE = 14 * WINDOW_PX
NEARLY_FULL = 0.8
"""Least share of the full difference in the two pixels beyond those at a border where no other border is near."""


@dataclass(frozen=True, slots=True, eq=False)
class CodeBits:
    """The bits of one direction that the camera resolves."""

    packed: NDArray[np.uint8]
    """(n / 8, h, w): ``bits``, eight to a byte."""
    count: int
    contrast: Floats
    """(h, w): the swing that all but a quarter of the bits reach, in grey values; without inverses, that of the references
    or the range. It is 0 where the finest image does not illuminate the pixel: coarse stripes also light by reflection
    from the room."""
    left_out: tuple[int, int]
    """Number of images left out at the beginning and at the end, as their stripes are finer than the camera's pixels."""
    borders: Floats | None = None
    """Place between two neighbours along the direction, 0 … 1, at which a bit changes: (h, w − 1), of y (w, h − 1); NaN
    where none does. ``None`` where fringes make the coordinate."""

    @property
    def bits(self) -> NDArray[np.bool_]:
        """True (n, h, w), in the order of the images, where the stripe is bright.

        Images at either end that the camera cannot resolve are left out.
        """
        return np.unpackbits(self.packed, axis=0, count=self.count).view(np.bool_)

    def numbered(self, axis: AxisConvention, rows: slice) -> tuple[NDArray[np.int32], float]:
        """Return the stripe numbers of some rows, and the width of the stripes."""
        bits = np.unpackbits(self.packed[:, rows], axis=0, count=self.count).view(np.bool_)
        return number_stripes(bits, self.left_out, axis)


def read_bits(images: ImageSet, axis: AxisConvention, sine_mean: Floats | None) -> CodeBits:
    """Return the bits of a direction.

    ``sine_mean`` (h, w) is the mean of its sine frames, ``None`` without.
    """
    gray, inverse = (images.all_of(shows, axis.name) for shows in (Shows.GRAY, Shows.INVERSE))
    bright, dark = images.image(Shows.BRIGHT), images.image(Shows.DARK)
    references = [reference for reference in (dark, bright) if reference is not None]
    is_vertical = axis.name == "y"

    def lines(image: NDArray[Any], part: slice) -> Floats:
        return (image[:, part].T if is_vertical else image[part]).astype(np.float32)

    def signed(part: slice) -> tuple[Floats, Floats | None]:
        """Return the differences from the threshold (n, lines, length) of some lines, and the known swing."""
        stack = np.stack([lines(bright_lines, part) for bright_lines in gray])
        if len(inverse):
            for bright_lines, inverted in zip(stack, inverse, strict=True):
                bright_lines -= lines(inverted, part)
            return stack, None
        if len(references) == 2:
            low, high = (lines(bright_lines, part) for bright_lines in references)
        elif sine_mean is not None:
            return stack - lines(sine_mean, part), None
        else:
            low, high = stack.min(axis=0), stack.max(axis=0)
        return stack - np.float32(0.5) * (low + high), high - low

    count, length = images.shape[::-1] if is_vertical else images.shape
    parts = [slice(begin, begin + LINES_AT_ONCE) for begin in range(0, count, LINES_AT_ONCE)]
    # Two passes over the lines: images can be left out only after all windows were examined, and no stack of floats
    # outlives its lines.
    windows = [_windows(signed(part)[0]) for part in parts]
    shares, largest = (
        np.concatenate([share.reshape(len(share), -1) for share in kind], axis=1) for kind in zip(*windows, strict=True)
    )
    left_out = _count_unresolved(shares[:, largest[0] > LEAST_SWING * np.quantile(largest, 0.95)], axis.fine_first)
    resolved = slice(left_out[0], len(gray) - left_out[1])
    packed = np.empty((-(-(resolved.stop - resolved.start) // 8), count, length), np.uint8)
    contrast = np.empty((count, length), np.float32)
    borders = np.empty((count, length - 1), np.float32) if sine_mean is None else None
    for part, (distinct_shares, _) in zip(parts, windows, strict=True):
        stack, swing = signed(part)
        stack = stack[resolved]
        packed[:, part] = np.packbits(stack > 0.0, axis=0)
        if swing is None:
            # One bit, or two of narrow stripes, may be at a border: the others tell how much light there is.
            swing = np.partition(np.abs(stack), len(stack) // 4, axis=0)[len(stack) // 4]
        is_lit = distinct_shares[resolved][0 if axis.fine_first else -1] >= MODULATED
        contrast[part] = swing * cv2.resize(
            is_lit.astype(np.float32), swing.shape[::-1], interpolation=cv2.INTER_NEAREST
        )
        if borders is not None:
            borders[part] = _borders(stack)
    if is_vertical:
        packed, contrast = np.swapaxes(packed, 1, 2), np.ascontiguousarray(contrast.T)
    return CodeBits(packed, resolved.stop - resolved.start, contrast, left_out, borders)


def _windows(signed: Floats) -> tuple[Floats, Floats]:
    """Return the share of pixels with distinct stripes by image and window, and the mean swing by window.

    ``signed`` are differences (n, lines, length); the swing is the largest absolute difference over the images, and has a
    first dimension of 1.
    """
    size = np.abs(signed)
    largest = size.max(axis=0)
    grid = tuple(max(1, length // WINDOW_PX) for length in largest.shape[::-1])
    distinct = [(difference > np.float32(DISTINCT) * largest).astype(np.float32) for difference in size]
    means = [cv2.resize(image, grid, interpolation=cv2.INTER_AREA) for image in (*distinct, largest)]
    return np.stack(means[:-1]), np.stack(means[-1:])


def _count_unresolved(shares: Floats, fine_first: bool) -> tuple[int, int]:
    """Return how many images at the beginning and at the end have stripes that are not resolved.

    ``shares`` are from ``_windows``. A window counts if stripes four times as wide modulate it: coarse ones light the room
    as well, which is no evidence for finer ones.
    """
    ordered = shares[::-1] if fine_first else shares
    count, windows = ordered.shape
    modulated = [
        float(np.mean(window_shares >= MODULATED)) if windows else 0.0
        for window_shares in (ordered[0], ordered[0], *ordered[:-2])
    ]
    is_resolved = [
        float(np.mean(window_shares >= LEAST_DISTINCT_SHARE)) > 0.5 * among > 0.0
        for window_shares, among in zip(ordered, modulated, strict=False)
    ]
    finest = max((k for k in range(count) if is_resolved[k]), default=-1)
    # With fewer images the cause is not fineness.
    out = count - 1 - finest if finest + 1 >= LEAST_BITS else 0
    return (out, 0) if fine_first else (0, out)


def _borders(signed: Floats) -> Floats:
    """Return where bits change between neighbours, as mean over the bits.

    ``signed`` are differences (n, lines, length). A pixel is the mean over its area: with t the difference over the full
    one, 1 before the border and −1 behind it, the sum of t over pixels on both sides is twice the distance of the border
    from their middle. Two pixels count, and four where two on either side are nearly full: then light that a lens blurs
    beyond two of them counts, and another border does not.
    """
    full = np.maximum(np.abs(signed).max(axis=0), np.float32(1e-3))
    lines = signed / full
    total = np.zeros((lines.shape[1], lines.shape[2] - 1), np.float32)
    count = np.zeros(total.shape, np.float32)
    for line in lines:
        row, column = np.nonzero((line[:, :-1] > 0.0) != (line[:, 1:] > 0.0))
        before, after = line[row, column], line[row, column + 1]
        side = np.where(before > 0.0, np.float32(0.5), np.float32(-0.5))
        place = np.float32(0.5) + side * (before + after)
        # Two pixels before and two behind those at the border, each with the sign of its side.
        around = [side * line[row, np.clip(column + off, 0, line.shape[1] - 1)] for off in (-2, -1, 2, 3)]
        least_full = np.minimum(np.minimum(around[0], around[1]), -np.maximum(around[2], around[3]))
        wide = least_full > np.float32(0.5 * NEARLY_FULL)
        place += np.where(wide, around[1] + around[2], np.float32(0.0))
        total[row, column] += np.clip(place, 0.0, 1.0)
        count[row, column] += 1.0
    with np.errstate(invalid="ignore"):
        return np.asarray(total / count, np.float32)


def stripe_numbers(bits: NDArray[np.bool_], axis: AxisConvention) -> NDArray[np.int32]:
    """Return the stripe number (h, w) int32 of each pixel, from ``bits`` (n, h, w) by the convention."""
    ordered = bits[::-1] if axis.fine_first else bits
    number = np.zeros(bits.shape[1:], np.int32)
    last = np.zeros(bits.shape[1:], np.bool_)
    for bit in ordered:
        is_bright = ~bit if axis.inverted else bit
        # Gray code: a digit of the number is the image's bit, inverted where the digit before is set.
        last = is_bright if axis.plain_binary else is_bright ^ last
        number = 2 * number + last
    return number


def number_stripes(
    bits: NDArray[np.bool_], left_out: tuple[int, int], axis: AxisConvention
) -> tuple[NDArray[np.int32], float]:
    """Return the stripe numbers and the width of the stripes in px of the pattern.

    Without its last digit a number counts stripes of twice the width. That digit is dropped where the finest images were
    left out, and where stripes are finer than half a fringe, which the phase resolves.
    """
    number = stripe_numbers(bits, axis)
    stripe_px = axis.stripe_px * 2.0 ** left_out[0 if axis.fine_first else 1]
    while axis.periods_px and stripe_px <= 0.2501 * axis.periods_px[axis.numbered]:
        number >>= 1
        stripe_px *= 2.0
    return number, stripe_px
