"""Specks: pixels that a particle passed while their fringes were recorded.

Their phase is wrong. Of four steps of a quarter period, opposite ones have the same sum, I0 + I2 = I1 + I3 = 2A, and
both directions have the same mean. A speck breaks one or the other. An even harmonic of the projector's response breaks
the first everywhere by a constant times cos 2φ, which is measured and subtracted.

Symbols: cosine = I0 − I2 = 2B cos φ, sine = I3 − I1 = 2B sin φ, twice = 2B, off = I0 − I1 + I2 − I3.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import CameraDecoder, Mask
from appliance.measure.light.noise import CameraNoise
from appliance.measure.light.patterns import Direction, PatternSequence

SIGMAS = 6.0
SHARE = 0.12
"""Largest disagreement beside noise, over the modulation: blur makes the harmonic vary over the image."""
MEAN_SHARE = 0.25
"""The same for the two directions' means; it is larger, since motion and flicker are no specks."""
SAMPLES = 20_000
STRUCK = np.uint8(Mask.CONTRADICTION)
_NAN, _ZERO, _ONE = np.float32(np.nan), np.uint8(0), np.uint8(1)


class DisagreementLimits(NamedTuple):
    """Disagreement without specks."""

    second_x: np.float32
    """Disagreement of the steps over cos 2φ, in twice the modulation, for X, and below for Y."""
    second_y: np.float32
    offset_x: np.float32
    """Difference of the sums of opposite steps by ambient light, everywhere."""
    offset_y: np.float32
    offset_mean: np.float32
    """The same for the sums of both directions."""
    dark_dn2: np.float32
    """Variance of a sum of four steps at no light, times ``SIGMAS`` squared."""
    shot_dn: np.float32
    """Additional variance per grey value of that sum, times ``SIGMAS`` squared."""


def warm_up(frames: NDArray[np.uint8]) -> None:
    """Run the kernels on frames (n, h, w) of any content."""
    shape, zero = frames.shape[1:], np.float32(0.0)
    p_px, q_px, mask = np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
    allowed = DisagreementLimits(*(zero for _ in DisagreementLimits._fields))
    a, b, c, d, e, f, g, h = frames[:8]
    _mask(a, b, c, d, e, f, g, h, np.zeros((shape[0], 2), np.int32), allowed, p_px, q_px, mask)


def mask_specks(
    sequence: PatternSequence, frames: NDArray[np.uint8], decoded: CameraDecoder, noise: CameraNoise
) -> int:
    """Mask pixels of ``decoded`` that a speck passed in ``frames`` (n, h, w) uint8; return their number.

    Call after the last frame. Their mask becomes CONTRADICTION, and they lose their coordinates.
    """
    steps = [frames[k] for direction in Direction for k in sequence.axis(direction).sine]
    allowed = _allowed(steps, decoded.mask, noise)
    if allowed is None:
        return 0
    a, b, c, d, e, f, g, h = steps
    return int(
        _mask(a, b, c, d, e, f, g, h, decoded.illuminated_columns, allowed, decoded.p_px, decoded.q_px, decoded.mask)
    )


def _allowed(steps: list[NDArray[np.uint8]], mask: NDArray[np.uint8], noise: CameraNoise) -> DisagreementLimits | None:
    stride = max(1, int((mask.size / SAMPLES) ** 0.5))
    sample = (slice(stride // 2, None, stride), slice(stride // 2, None, stride))
    valid = mask[sample] == Mask.VALID
    if not valid.any():
        return None
    i = [step[sample][valid].astype(np.float32) for step in steps]
    seconds, offsets = [], []
    # Common to all pixels: an offset (ambient light), and an even harmonic, as a slope over cos 2φ.
    for i0, i1, i2, i3 in (i[:4], i[4:]):
        off = i0 - i1 + i2 - i3
        offsets.append(float(np.median(off)))
        second = _second(i0 - i2, i3 - i1)
        # Robust: most specks are rare, but one of them weighs as much as a thousand pixels.
        off -= offsets[-1]
        strong = np.abs(second) > 0.5 * np.median(np.abs(second))
        seconds.append(float(np.median(off[strong] / second[strong])) if strong.any() else 0.0)
    means = float(np.median(i[0] + i[1] + i[2] + i[3] - i[4] - i[5] - i[6] - i[7]))
    dark_dn2 = 4.0 * noise.dark_variance_dn2
    return DisagreementLimits(
        np.float32(seconds[0]),
        np.float32(seconds[1]),
        np.float32(offsets[0]),
        np.float32(offsets[1]),
        np.float32(means),
        np.float32(SIGMAS**2 * dark_dn2),
        np.float32(SIGMAS**2 * noise.dn_per_e),
    )


def _second(cosine: NDArray[np.float32], sine: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return cos 2φ times twice the modulation."""
    length = np.maximum(np.hypot(cosine, sine), np.float32(1.0))
    return np.asarray((cosine - sine) * (cosine + sine) / length, np.float32)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _flag(
    i0: NDArray[np.uint8],
    i1: NDArray[np.uint8],
    i2: NDArray[np.uint8],
    i3: NDArray[np.uint8],
    second: np.float32,
    offset: np.float32,
    allowed: DisagreementLimits,
    total: NDArray[np.float32],
    length: NDArray[np.float32],
    struck: NDArray[np.uint8],
) -> None:
    """Examine one direction of a row: add 1 to ``struck`` where opposite steps disagree.

    Writes the sum of its steps to ``total`` and twice its modulation to ``length``.
    """
    for x in range(struck.size):
        a, b, c, d = np.float32(i0[x]), np.float32(i1[x]), np.float32(i2[x]), np.float32(i3[x])
        cosine, sine = a - c, d - b
        squared = cosine * cosine + sine * sine
        twice = np.sqrt(squared if squared > np.float32(1.0) else np.float32(1.0))
        light = a + b + c + d
        # |I0 − I1 + I2 − I3 − its common part| beyond the allowed share, against SIGMAS of its noise.
        off = (a - b) + (c - d) - offset - second * (cosine - sine) * (cosine + sine) / twice
        room = np.float32(0.5 * SHARE) * twice
        over = abs(off) - room
        over = over if over > np.float32(0.0) else np.float32(0.0)
        struck[x] = struck[x] | (_ONE if over * over > allowed.dark_dn2 + allowed.shot_dn * light else _ZERO)
        total[x], length[x] = light, twice


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _mask(
    a: NDArray[np.uint8],
    b: NDArray[np.uint8],
    c: NDArray[np.uint8],
    d: NDArray[np.uint8],
    e: NDArray[np.uint8],
    f: NDArray[np.uint8],
    g: NDArray[np.uint8],
    h: NDArray[np.uint8],
    illuminated: NDArray[np.int32],
    allowed: DisagreementLimits,
    p_px: NDArray[np.float32],
    q_px: NDArray[np.float32],
    mask: NDArray[np.uint8],
) -> int:
    rows, columns = mask.shape
    # Per direction (0: x, 1: y) and pixel: the sum 4A of its steps, and its length 2B.
    totals, lengths = np.empty((2, columns), np.float32), np.empty((2, columns), np.float32)
    struck = np.empty(columns, np.uint8)
    count = 0
    for y in range(rows):
        first, stop = illuminated[y]
        if first >= stop:
            continue
        # Each direction by itself: I0 + I2 against I1 + I3.
        part = slice(first, stop)
        n = stop - first
        flags = struck[:n]
        flags[:] = _ZERO
        _flag(a[y, part], b[y, part], c[y, part], d[y, part], allowed.second_x, allowed.offset_x, allowed,
              totals[0, :n], lengths[0, :n], flags)  # fmt: skip
        _flag(e[y, part], f[y, part], g[y, part], h[y, part], allowed.second_y, allowed.offset_y, allowed,
              totals[1, :n], lengths[1, :n], flags)  # fmt: skip
        # Both directions together: 4A_x − 4A_y without its common part, against the weaker fringes.
        for x in range(n):
            apart = abs(totals[0, x] - totals[1, x] - allowed.offset_mean)
            weaker_length = min(lengths[0, x], lengths[1, x])
            # A pixel that is masked for another reason keeps that reason.
            hit = (flags[x] != _ZERO) | (apart > np.float32(2.0 * MEAN_SHARE) * weaker_length)
            if hit & (mask[y, first + x] == _ZERO):
                # Both coordinates of such a pixel are wrong.
                mask[y, first + x] = STRUCK
                p_px[y, first + x] = _NAN
                q_px[y, first + x] = _NAN
                count += 1
    return count
