"""Specks drawn into recorded frames: lit as the pattern has it where they are, drifting, out of focus."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.patterns import Kind, PatternSequence


def add_specks(
    frames: NDArray[np.uint8], sequence: PatternSequence, count: int, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """``frames`` (n, h, w) uint8 with ``count`` specks of 15 to 200 DN and 0.7 to 3 px, which drift a pixel per frame."""
    out = frames.astype(np.float32)
    _, h, w = out.shape
    for _ in range(count):
        x, y = rng.uniform((0.0, 0.0), (w, h))
        u_per_frame, v_per_frame = rng.normal(0.0, 1.2, 2)
        sigma, phase = rng.uniform(0.7, 3.0), rng.uniform(0.0, 2.0 * np.pi)
        peak = 15.0 * (200.0 / 15.0) ** rng.uniform()
        reach = int(4.0 * sigma) + 1
        for k, pattern in enumerate(sequence.patterns):
            light = {
                Kind.BRIGHT: 1.0,
                Kind.DARK: 0.0,
                Kind.GRAY: float(rng.integers(0, 2)),
                Kind.SINE: 0.5 + 0.5 * np.cos(phase + pattern.index * np.pi / 2.0),
            }[pattern.kind]
            at_x, at_y = x + u_per_frame * k, y + v_per_frame * k
            left, top = max(int(at_x) - reach, 0), max(int(at_y) - reach, 0)
            part = out[k, top : max(int(at_y) + reach, 0), left : max(int(at_x) + reach, 0)]
            v, u = np.mgrid[top : top + part.shape[0], left : left + part.shape[1]]
            part += peak * light * np.exp(-((u - at_x) ** 2 + (v - at_y) ** 2) / (2.0 * sigma**2))
    return np.clip(np.rint(out), 0, 255).astype(np.uint8)
