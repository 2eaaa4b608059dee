"""Cramér-Rao bound of the phase noise of a point that moves along with the fringes.

It is of one surface element that is followed through all frames, without its neighbours. Unknown are its albedo, the
ambient light, and both phases; mean and swing of the fringes in proportion to the albedo are known. Relative to four
steps of 90° at rest. ``./dev run python -m bench.verdict.compensation_bound`` prints the table of
``docs/compensation.md``.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MEAN, SWING = 0.5, 0.4
"""Of the sine fringes, as shares of full light: codes 8 to 247, blurred by projector and camera."""
PX_PER_MM = 4.0 / (60.0 / 60.0)
"""Pattern px per mm of way across the view: 4 px a frame at 60 mm/s and 60 Hz."""
FRAME_S = 1.0 / 60.0
PERIODS_PX = (16, 32, 64)
SPEEDS_MM_S = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0)
PHASES = 24
GRAY_IMAGES = {16: 14, 32: 12, 64: 10}


def shrunk_steps(speed_mm_s: float, period_px: int) -> Array:
    """Return the four phases (rad) of an element that moves along with the fringes; backwards for negative speeds."""
    less = 2.0 * math.pi * speed_mm_s * FRAME_S * PX_PER_MM / period_px
    return np.asarray((0.5 * math.pi - less) * (np.arange(4) - 1.5))


def four_sines(steps_rad: Array) -> float:
    """Return the standard deviation by the four sines alone over that of 90° steps, as the RMS over all phases."""
    A = np.stack([np.ones(4), np.cos(steps_rad), -np.sin(steps_rad)], -1)
    normal = A.T @ A
    if np.linalg.cond(normal) > 1e12:
        return math.inf
    inverse = np.linalg.inv(normal)
    return math.sqrt(inverse[1, 1] + inverse[2, 2])


def all_frames(steps_rad: Array, gray_images: int) -> float:
    """Return the bound by all frames, with equal steps in both directions, over four sines alone with 90° steps."""
    phase = 2.0 * math.pi * np.arange(PHASES) / PHASES
    variances = [_variance(x, y, steps_rad, gray_images) for x in phase for y in phase]
    return math.sqrt(float(np.mean(variances)) / (1.0 / (2.0 * SWING**2)))


def _variance(x: float, y: float, steps_rad: Array, gray_images: int) -> float:
    """Return the variance of the phase of x for albedo 1 and noise 1."""
    # Rows: derivatives by albedo, ambient light, phase of x, phase of y.
    zeros, ones = np.zeros(4), np.ones(4)
    light_x, light_y = (MEAN + SWING * np.cos(phase + steps_rad) for phase in (x, y))
    rows = np.concatenate([
        np.stack([light_x, ones, -SWING * np.sin(x + steps_rad), zeros], -1),
        np.stack([light_y, ones, zeros, -SWING * np.sin(y + steps_rad)], -1),
        np.tile([1.0, 1.0, 0.0, 0.0], (1 + gray_images // 2, 1)),
        np.tile([0.0, 1.0, 0.0, 0.0], (1 + gray_images // 2, 1)),
    ])  # fmt: skip
    normal = rows.T @ rows
    return float(np.linalg.inv(normal)[2, 2]) if np.linalg.cond(normal) < 1e9 else math.inf


def table() -> list[tuple[int, float, float, float, float]]:
    """Return period, speed, step in degrees, noise by the four sines alone, and the bound by all frames."""
    rows = []
    for period_px in PERIODS_PX:
        for speed in (*SPEEDS_MM_S, -40.0):
            steps = shrunk_steps(speed, period_px)
            rows.append(
                (
                    period_px,
                    speed,
                    math.degrees(steps[1] - steps[0]),
                    four_sines(steps),
                    all_frames(steps, GRAY_IMAGES[period_px]),
                )
            )
    return rows


def main() -> None:
    """Print the table."""
    print("| period | along with the fringes, mm/s | step | four sines, followed | bound of all frames |")
    print("|---|---|---|---|---|")
    for period_px, speed, step, alone, bound in table():
        print(f"| {period_px} px | {speed:.0f} | {step:.0f}° | {alone:.2f} | {bound:.2f} |")


if __name__ == "__main__":
    main()
