"""Merging of two exposures of one scene: the maps of two decoded sequences, pixel by pixel.

Each coordinate has a variance that follows from modulation, offset and camera noise. If both sequences have a
coordinate, the result is their weighted mean, and they must agree within their noise. If one is saturated or too dark,
the other one is used. Pixels that disagree are masked, since the scene moved in between.

Symbols: V1, V2 are the variances of a pixel's coordinates in the first and in the second sequence; their mean is
(V2 x1 + V1 x2)/(V1 + V2), with variance V1 V2/(V1 + V2). a and b mark the pixels with a valid coordinate in each.
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
"""Largest difference of two coordinates of one point in standard deviations: noise exceeds it once in a million pixels.
"""
ROWS = 64
"""Number of rows that are merged at once, which bounds the memory."""
SAMPLE_ROWS = 8
"""Distance of the rows from which the clearer sequence is determined."""
BLOCK_ROWS, BLOCK_COLUMNS, LEAST_SHARED = 6, 8, 100
"""Blocks of the image in which a shift is measured, and the least number of pixels of a block that both sequences have.
"""
MAX_SHIFT = 0.5
"""Largest shift of the whole image, over the noise of a difference, that does not show in the surface."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """Agreement of two sequences in one camera. Shares are of all pixels, 0..1."""

    first: float
    """Pixels that only the first sequence has."""
    second: float
    both: float
    """Pixels that both have, including those masked."""
    masked: float
    """Pixels in which the two disagreed."""
    shift: float | None
    """Shift of the whole image from the first sequence to the second, over the noise of a difference: the median over
    the blocks' median differences; ``None``: too few pixels are in both."""

    @property
    def agrees(self) -> bool | None:
        """True if both show the same scene; ``None``: unknown."""
        return None if self.shift is None else self.shift <= MAX_SHIFT


def merge(
    first: Maps,
    second: Maps,
    noise: tuple[CameraNoise, CameraNoise],
    period_px: int,
    variance_px2: NDArray[np.float32],
) -> Agreement:
    """Write the merged maps into those of ``first``, after the last frame of both sequences.

    No point may have been found before. ``noise`` is that of the camera in either sequence. ``variance_px2`` (h, w)
    float32 is filled with the variance of each pixel's coordinates, in px² of the pattern. Where both sequences have a
    coordinate, modulation and Gray threshold are those of the sequence with the smaller variance in most of the image;
    elsewhere those of the one that has a coordinate. Raises ValueError for maps of different size.
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
    """Return True if the second sequence has the smaller variance in most sampled pixels.

    The answer is one for the image: if the modulation changed between two exposures from pixel to pixel, it would look
    like an edge of the albedo everywhere, and the standard deviations of points would be too large.
    """
    rows = slice(0, None, SAMPLE_ROWS)
    shared = (first.mask[rows] == Mask.VALID) & (second.mask[rows] == Mask.VALID)
    clearer = _variance_px2(second, noise[1], period_px, rows) < _variance_px2(first, noise[0], period_px, rows)
    return bool(2 * np.count_nonzero(clearer & shared) > np.count_nonzero(shared))


def _shift(differences: NDArray[np.float32]) -> float | None:
    """Return the shift of the differences (2, h, w) over their noise, NaN where a sequence has none."""
    shifts = []
    for strip in np.array_split(differences, BLOCK_ROWS, axis=1):
        for block in np.array_split(strip, BLOCK_COLUMNS, axis=2):
            finite = block[:, ~np.isnan(block[0])]
            if finite.shape[1] >= LEAST_SHARED:
                shifts.append(float(np.max(np.abs(np.median(finite, axis=1)))))
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
    mask, second_mask = first.mask[rows], second.mask[rows]
    variance = [_variance_px2(d, n, period_px, rows) for d, n in ((first, noise[0]), (second, noise[1]))]
    a, b = mask == Mask.VALID, second_mask == Mask.VALID
    # An edge in the clearer sequence is an edge, even if the other does not show it.
    doubtful = (Mask.CONTRADICTION, Mask.EDGE)
    a &= ~(np.isin(second_mask, doubtful) & (variance[1] < variance[0]))
    b &= ~(np.isin(mask, doubtful) & (variance[0] < variance[1]))
    # Differences over their noise √(V1 + V2), of both coordinates.
    in_both = a & b
    expected = np.sqrt(variance[0] + variance[1])
    apart = np.zeros(mask.shape, np.float32)
    for k, (mine, theirs) in enumerate(((first.p_px[rows], second.p_px[rows]), (first.q_px[rows], second.q_px[rows]))):
        z = (mine - theirs) / expected
        differences[k, rows][in_both] = z[in_both]
        apart[in_both] = np.maximum(apart, np.abs(z))[in_both]
    differs = in_both & (apart > MAX_SIGMA)
    merged = in_both & ~differs
    added = b & ~a
    # The weighted mean, or the only value.
    weight = variance[1] / (variance[0] + variance[1])
    for mine, theirs in ((first.p_px[rows], second.p_px[rows]), (first.q_px[rows], second.q_px[rows])):
        mine[merged] = (weight * mine + (1.0 - weight) * theirs)[merged]
        mine[added] = theirs[added]
        mine[~(a | b) | differs] = np.nan
    # The mask: edges of the clearer sequence, contradictions of both, and pixels that only the second one has.
    mask[~a & (mask == Mask.VALID)] = Mask.EDGE
    mask[differs] = Mask.CONTRADICTION
    mask[added] = Mask.VALID
    # 1/V = 1/V1 + 1/V2; modulation and threshold are those of one sequence.
    mean = 1.0 / (1.0 / variance[0] + 1.0 / variance[1])
    variance_px2[rows] = np.where(merged, mean, np.where(added, variance[1], variance[0]))
    from_second = added | merged if second_is_clearer else added
    first.modulation_half_dn[rows][from_second] = second.modulation_half_dn[rows][from_second]
    first.gray_threshold[rows][from_second] = second.gray_threshold[rows][from_second]
    return np.array([(a & ~b).sum(), added.sum(), in_both.sum(), differs.sum()], np.int64)


def _variance_px2(maps: Maps, noise: CameraNoise, period_px: int, rows: slice) -> NDArray[np.float32]:
    """Return the variance (rows, w) of either coordinate.

    In the shadow, where it has no meaning, it is that of the least modulation.
    """
    illuminated = maps.mask[rows] != Mask.SHADOW
    offset_dn = np.float32(maps.offset_per_threshold) * maps.gray_threshold[rows].astype(np.float32)
    modulation = np.where(illuminated, np.maximum(0.5 * maps.modulation_half_dn[rows].astype(np.float32), 1.0), 1.0)
    return np.float32(maps.variance_factor) * four_step_variance_px2(modulation, offset_dn, noise, period_px)


def _size(decoder: Maps) -> str:
    height, width = decoder.mask.shape
    return f"{width}x{height}"
