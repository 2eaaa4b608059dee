"""Photographs of a flat wall under the projector and other light, in plain NumPy: light in, grey values out, clipped.

Exposure, ambient light and albedo are exact here, so that what a judge says of them can be held against the truth. Where
light falls on real surfaces is for the simulated cameras.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.acquisition import AcquisitionSettings
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.noise import FULL_DN, TYPICAL, TYPICAL_PAIR, CameraNoise, StereoNoise, camera_noise
from appliance.measure.light.patterns import Direction, PatternSequence, build_sequence
from appliance.measure.scan_images import ScanImages

WHITE_DN_PER_US = 0.030
"""Of white on an albedo of 1: 360 DN in 12 ms."""
WIDTH_PX, HEIGHT_PX = 240, 180


@dataclass(frozen=True)
class Wall:
    """What both cameras see; arrays are (h, w)."""

    albedo: NDArray[np.float64]
    ambient: NDArray[np.float64] | float = 0.0
    """As a share of the projector's white."""
    flicker: tuple[float, ...] = ()
    """Factor of the ambient light in each frame; none: steady."""
    patches: dict[int, NDArray[np.float64]] = field(default_factory=dict)
    """Extra light (h, w) in single frames, as a share of white."""
    bits: tuple[float, ...] = ()
    """What each bit of a code, from the highest one on, gives beyond its part, as a share of white: an exposure that sees a part of
    a frame sees some of a projector's bits longer than others."""


def wall(seed: int, darkest: float = 0.02, brightest: float = 0.9) -> NDArray[np.float64]:
    """An albedo (h, w) of soft patches between two ends."""
    rng = np.random.default_rng(seed)
    coarse = rng.random((6, 8))
    y, x = np.linspace(0, 4.999, HEIGHT_PX), np.linspace(0, 6.999, WIDTH_PX)
    i, j = y.astype(int), x.astype(int)
    a, b = (y - i)[:, None], (x - j)[None, :]
    near = [[coarse[np.ix_(i + m, j + n)] for n in (0, 1)] for m in (0, 1)]
    soft = (1 - a) * ((1 - b) * near[0][0] + b * near[0][1]) + a * ((1 - b) * near[1][0] + b * near[1][1])
    return np.asarray(darkest * (brightest / darkest) ** soft)


def coordinates(shift_px: float = 0.0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pattern column and row that each pixel sees."""
    v, u = np.mgrid[0:HEIGHT_PX, 0:WIDTH_PX].astype(np.float64)
    return 60.3 + shift_px + 2.7 * u + 0.11 * v, 51.7 + 2.7 * v - 0.07 * u


def light(sequence: PatternSequence, shift_px: float = 0.0) -> NDArray[np.float64]:
    """The projector's light (n, h, w), 1 for white: sines exact, Gray edges a pattern pixel wide."""
    p, q = coordinates(shift_px)
    shown = np.empty((len(sequence), *p.shape))
    for k, pattern in enumerate(sequence.patterns):
        x = p if pattern.direction is Direction.X else q
        if pattern.kind.value == "sine":
            phase = 2.0 * np.pi * (x + 0.5) / pattern.period_px + pattern.index * np.pi / 2.0
            shown[k] = (127.5 + 119.5 * np.cos(phase)) / 247.0
        else:
            shown[k] = np.interp(x, np.arange(pattern.size_px), pattern.codes() / 247.0)
    return shown


def with_bits(shown: NDArray[np.float64], bits: tuple[float, ...]) -> NDArray[np.float64]:
    """The light (n, h, w) of a projector whose bits are not worth what they should be."""
    code = np.rint(255.0 * shown).astype(np.int64)
    return shown + sum((more * ((code >> (7 - k)) & 1) for k, more in enumerate(bits)), np.zeros_like(shown))


def photograph(
    scene: Wall,
    exposure: Exposure,
    seed: int,
    sequence: PatternSequence | None = None,
    noise: CameraNoise | None = None,
) -> ScanImages:
    """Both cameras' frames; ``noise`` is of 0 dB."""
    sequence = sequence or build_sequence(16)
    noise = noise or TYPICAL
    gain = 10.0 ** (exposure.gain_db / 20.0)
    flicker = np.array(scene.flicker or (1.0,) * len(sequence))
    rng = np.random.default_rng(seed)
    frames = {}
    for side, shift_px in (("left", 0.0), ("right", 17.0)):
        arriving = with_bits(light(sequence, shift_px), scene.bits) + flicker[:, None, None] * scene.ambient
        for k, extra in scene.patches.items():
            arriving[k] += extra
        grey = WHITE_DN_PER_US * exposure.light * scene.albedo * arriving
        sigma = np.sqrt((noise.read_dn * gain) ** 2 + noise.dn_per_e * gain * grey)
        grey = noise.black_dn + grey + sigma * rng.standard_normal(grey.shape)
        frames[side] = np.clip(np.rint(grey), 0, FULL_DN).astype(np.uint8)
    cameras = (
        TYPICAL_PAIR if not exposure.gain_db else StereoNoise(*(camera_noise(13_000, 20, 2, exposure.gain_db),) * 2)
    )
    return ScanImages(sequence, frames, {}, AcquisitionSettings(exposure, noise=cameras))
