"""Owns the Gray thresholds of samples before which the lit water outshines the object, and which of them have none.

Half way between a sample's darkest and brightest value a Gray image's bit is told only as long as the water's veil is fainter
than the object. Beyond, coarse stripes that light the water turn bits over, in good scans too. What decoding does about that
(``reconstruct.decode.backscatter``) is done here along the lines: the fringes tell the object's light, and sure samples how much of the
veil each image lights. Across the base line nothing need be done: there the water is lit by the same stripe as what it hides.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.patterns.sequence import Direction, PatternSequence
from appliance.reconstruct.decode.backscatter import (
    APART_SIGMAS,
    BEYOND,
    MARGIN,
    MARGIN_OF_VEIL,
    MIN_LIGHT_DN,
    NOISE_SIGMAS,
    SURE,
    Floats,
    any_backscatter,
    fringe_scale,
    illuminated_share,
    sample_pixels,
)
from appliance.scan.noise import CameraNoise
from appliance.verdict.identity_lines import Lines

ALL = (slice(None), slice(None))
CLEAR_MODULATION_DN = 3.0
"""From here on, fringes are asked how much of the object's light they are: less than decoding asks, since few samples serve."""


def thresholds(
    lines: Lines, sequence: PatternSequence, noise: CameraNoise, order: NDArray[np.int64]
) -> tuple[Floats, Floats]:
    """Of each Gray image along the lines, for frame ``order[k]`` taken as pattern k: (images, lines, samples), or (1, lines,
    samples) where one serves all, NaN where there is none; and how near to it a bit is in doubt, (lines, samples).
    """
    plain = np.float32(0.5) * (lines.low.astype(np.float32) + lines.high.astype(np.float32))
    none = np.zeros(plain.shape, np.float32)
    if lines.along is not Direction.X:
        return plain[None], none
    frames = lines.values[order]
    bright, dark = (frames[k].astype(np.float32) for k in (sequence.bright, sequence.dark))
    mask = np.where(bright - dark < MIN_LIGHT_DN, np.uint8(1), np.uint8(0))
    scale = fringe_scale(sequence, frames, mask, noise, CLEAR_MODULATION_DN)
    if scale is None or not any_backscatter(sequence, frames, mask, scale):
        return plain[None], none
    pixels = sample_pixels(sequence, frames, ALL, scale)
    own = np.minimum(pixels.object_dn, pixels.light_dn)
    veil, apart_dn = pixels.light_dn - own, np.float32(APART_SIGMAS) * pixels.noise_dn
    room_dn = np.float32(0.5) * own + np.maximum(np.float32(BEYOND) * own, apart_dn)
    sure = np.float32(SURE) * pixels.object_dn - np.float32(NOISE_SIGMAS) * pixels.noise_dn
    without_veil = np.where(pixels.light_dn < np.float32(2.0) * sure, plain, np.float32(np.nan))
    told = []
    for k in sequence.axis(Direction.X).gray:
        gray = frames[k].astype(np.float32) - dark
        middle = _of_samples(illuminated_share(gray, pixels), gray.shape) * veil + np.float32(0.5) * own
        known = pixels.usable & np.isfinite(middle)
        middle[abs(gray - middle) > room_dn] = np.nan
        told.append(np.where(known, dark + middle, without_veil))
    doubt_dn = np.minimum(np.float32(MARGIN_OF_VEIL) * veil, np.float32(MARGIN) * own)
    return np.stack(told), doubt_dn + np.maximum(apart_dn - np.float32(0.5) * own, np.float32(0.0))


def _of_samples(share: Floats, shape: tuple[int, ...]) -> Floats:
    rows, columns = (np.arange(size) * cells // size for size, cells in zip(shape, share.shape, strict=True))
    return np.asarray(share[rows][:, columns], np.float32)
