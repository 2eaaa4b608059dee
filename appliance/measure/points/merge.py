"""Owns two exposures of one scene as one: the maps of two decoded sequences, merged pixel by pixel.

Each coordinate has a variance that follows from modulation, offset and camera noise; where both sequences have one,
they are weighted by it, and must agree within it. Where only one has one, because the other is saturated or too dark
there, that one is taken. What disagrees is masked: something moved in between.

Symbols: V1, V2 are the variances of a pixel's coordinates in the first and in the second sequence; their mean is
(V2 x1 + V1 x2)/(V1 + V2), with variance V1 V2/(V1 + V2). a and b say which sequence has a coordinate to be believed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import CameraDecoder, DecodedMaps, Mask
from appliance.measure.light.noise import CameraNoise
from appliance.measure.points.sigma import four_step_variance_px2

Maps = CameraDecoder | DecodedMaps
MAX_SIGMA = 5.0
"""Largest distance of two coordinates over its noise: those of one surface point differ by more in one pixel of a
million."""
ROWS = 64
"""Number of rows that are merged at once: the whole stays small."""
SAMPLE_ROWS = 8
"""Distance of the rows that tell which sequence is the clearer one."""
BLOCK_ROWS, BLOCK_COLUMNS, LEAST_SHARED = 6, 8, 100
"""Parts of the image each of which is asked whether it has moved, and the least number of pixels both sequences must
share in it."""
MAX_SHIFT = 0.5
"""Shift common to the image, over the noise of a difference, from which on what has moved is seen in the surface."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """Agreement of two sequences in one camera. Shares are of all pixels, 0..1."""

    first: float
    """Pixels that only the first sequence has."""
    second: float
    both: float
    """Pixels that both had, those masked included."""
    masked: float
    """Pixels in which the two disagreed."""
    shift: float | None
    """Movement of the whole image from the first sequence to the second: median over its parts of what the coordinates
    of neighbours have in common, over their noise; ``None`` where too few pixels are shared to tell."""

    @property
    def agrees(self) -> bool | None:
        """True if both saw the same; ``None``: it cannot be told."""
        return None if self.shift is None else self.shift <= MAX_SHIFT


def merge(
    first: Maps,
    second: Maps,
    noise: tuple[CameraNoise, CameraNoise],
    period_px: int,
    variance_px2: NDArray[np.float32],
) -> Agreement:
    """Write the merged maps into those of ``first``, after the last frame of both and before any point is found.

    ``noise`` is that of the camera in either sequence. ``variance_px2`` (h, w) float32 is filled with the variance of
    each pixel's coordinates, in px² of the pattern. Modulation and Gray threshold are, where both sequences have a
    coordinate, those of the sequence whose coordinates have the smaller variance in most of the image; else those of
    the one that has. Raises ValueError for maps of different size.
    """
    if first.mask.shape != second.mask.shape:
        raise ValueError(
            f"images of {_size(first)} and {_size(second)} px cannot be merged; both sequences must be of one camera"
        )
    counts = np.zeros(4, np.int64)
    differences = np.full((2, *first.mask.shape), np.nan, np.float32)
    second_is_clearer = _second_is_clearer(first, second, noise, period_px)
    for top in range(0, first.mask.shape[0], ROWS):
        rows = slice(top, top + ROWS)
        counts += _merge_rows(first, second, noise, period_px, rows, second_is_clearer, differences, variance_px2)
    first.illuminated_columns[:, 0] = np.minimum(first.illuminated_columns[:, 0], second.illuminated_columns[:, 0])
    first.illuminated_columns[:, 1] = np.maximum(first.illuminated_columns[:, 1], second.illuminated_columns[:, 1])
    first.illuminated_pixels = max(first.illuminated_pixels, second.illuminated_pixels)
    share = counts / first.mask.size
    return Agreement(float(share[0]), float(share[1]), float(share[2]), float(share[3]), _shift(differences))


def _second_is_clearer(first: Maps, second: Maps, noise: tuple[CameraNoise, CameraNoise], period_px: int) -> bool:
    """Tell whether the second sequence has the smaller variance in most of the pixels of every ``SAMPLE_ROWS``-th row.

    One answer for the image: a modulation that went to and fro between two exposures, from pixel to pixel, would look
    like an edge of the albedo everywhere, and points would expect more error than they have.
    """
    rows = slice(0, None, SAMPLE_ROWS)
    shared = (first.mask[rows] == Mask.VALID) & (second.mask[rows] == Mask.VALID)
    clearer = _variance_px2(second, noise[1], period_px, rows) < _variance_px2(first, noise[0], period_px, rows)
    return bool(2 * np.count_nonzero(clearer & shared) > np.count_nonzero(shared))


def _shift(differences: NDArray[np.float32]) -> float | None:
    """Return the shift of the differences (2, h, w) of both coordinates over their noise, NaN where only one sequence
    has one."""
    shifts = []
    for strip in np.array_split(differences, BLOCK_ROWS, axis=1):
        for block in np.array_split(strip, BLOCK_COLUMNS, axis=2):
            known = block[:, ~np.isnan(block[0])]
            if known.shape[1] >= LEAST_SHARED:
                shifts.append(float(np.max(np.abs(np.median(known, axis=1)))))
    return float(np.median(shifts)) if shifts else None


def _merge_rows(
    first: Maps,
    second: Maps,
    noise: tuple[CameraNoise, CameraNoise],
    period_px: int,
    rows: slice,
    second_is_clearer: bool,
    differences: NDArray[np.float32],
    variance_px2: NDArray[np.float32],
) -> NDArray[np.int64]:
    mask, other = first.mask[rows], second.mask[rows]
    variance = [_variance_px2(d, n, period_px, rows) for d, n in ((first, noise[0]), (second, noise[1]))]
    a, b = mask == Mask.VALID, other == Mask.VALID
    # What the clearer sequence shows as an edge is one, whatever the other shows.
    doubtful = (Mask.CONTRADICTION, Mask.EDGE)
    a &= ~(np.isin(other, doubtful) & (variance[1] < variance[0]))
    b &= ~(np.isin(mask, doubtful) & (variance[0] < variance[1]))
    # Differences over their noise √(V1 + V2), of both coordinates.
    both = a & b
    expected = np.sqrt(variance[0] + variance[1])
    apart = np.zeros(mask.shape, np.float32)
    for k, (mine, theirs) in enumerate(((first.p_px[rows], second.p_px[rows]), (first.q_px[rows], second.q_px[rows]))):
        z = (mine - theirs) / expected
        differences[k, rows][both] = z[both]
        apart[both] = np.maximum(apart, np.abs(z))[both]
    differs = both & (apart > MAX_SIGMA)
    merged = both & ~differs
    taken = b & ~a
    # The mean by variance, or the one there is.
    weight = variance[1] / (variance[0] + variance[1])
    for mine, theirs in ((first.p_px[rows], second.p_px[rows]), (first.q_px[rows], second.q_px[rows])):
        mine[merged] = (weight * mine + (1.0 - weight) * theirs)[merged]
        mine[taken] = theirs[taken]
        mine[~(a | b) | differs] = np.nan
    # A coordinate that the clearer sequence calls an edge, a contradiction of both, and what the second one gives.
    mask[~a & (mask == Mask.VALID)] = Mask.EDGE
    mask[differs] = Mask.CONTRADICTION
    mask[taken] = Mask.VALID
    # 1/V = 1/V1 + 1/V2; modulation and threshold stay what one sequence saw.
    mean = 1.0 / (1.0 / variance[0] + 1.0 / variance[1])
    variance_px2[rows] = np.where(merged, mean, np.where(taken, variance[1], variance[0]))
    from_second = taken | merged if second_is_clearer else taken
    first.modulation_half_dn[rows][from_second] = second.modulation_half_dn[rows][from_second]
    first.gray_threshold[rows][from_second] = second.gray_threshold[rows][from_second]
    return np.array([(a & ~b).sum(), taken.sum(), both.sum(), differs.sum()], np.int64)


def _variance_px2(maps: Maps, noise: CameraNoise, period_px: int, rows: slice) -> NDArray[np.float32]:
    """Return the variance (rows, w) of either coordinate.

    In the shadow, where nothing else means anything, it is that of the least modulation.
    """
    illuminated = maps.mask[rows] != Mask.SHADOW
    offset_dn = np.float32(maps.offset_per_threshold) * maps.gray_threshold[rows].astype(np.float32)
    modulation = np.where(illuminated, np.maximum(0.5 * maps.modulation_half_dn[rows].astype(np.float32), 1.0), 1.0)
    return np.float32(maps.variance_factor) * four_step_variance_px2(modulation, offset_dn, noise, period_px)


def _size(decoder: Maps) -> str:
    height, width = decoder.mask.shape
    return f"{width}x{height}"
