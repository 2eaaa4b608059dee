"""Is the veil of the harsher world that of photons? Single rays, all orders of scattering, against a Monte Carlo."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from bench.result import Measured
from bench.veil.photons import follow
from hw_sim.rendering.stage import Stage
from hw_sim.truth import draw_truth
from hw_sim.water.medium import Water
from hw_sim.water.particles import Particles
from hw_sim.water.veil import Veil

WIDTH_PX, HEIGHT_PX = 400, 300
PIXELS = ((101, 150), (201, 70), (201, 150))
"""Column and row of the rays that are followed."""
PERIODS_PX = (16.0, 32.0, 64.0)
END_Z_MM = 522.5
WATERS = ((1.0, 0.7, 1.10, 3.5835), (3.0, 0.8, 1.10, 3.5835), (3.0, 0.8, 1.06, 3.4))
"""Beam attenuation, 1/m, how much of it is scattering, and the particles' index and slope."""
PHOTONS = 120_000
Picture = NDArray[np.float32]


def measure() -> Iterable[Measured]:
    """The simulator's veil against photons: how bright, how much brighter than by single scattering, and the fringes in rows."""
    stage = Stage(draw_truth("realistic", 1, WIDTH_PX, HEIGHT_PX, Water().index))
    rays = stage.rays("left")
    black = (END_Z_MM - rays[..., 2]) / rays[..., 5]
    rows = np.arange(768.0)[:, None]
    for per_m, share, index, slope in WATERS:
        particles = Particles(share, index, slope)
        veils = {
            "single": Veil(rays, stage.lamp, Particles(0.0, index, slope), per_m, defocus=False),
            "all": Veil(rays, stage.lamp, particles, per_m, defocus=False),
        }
        white = {name: veil.seen(np.ones((768, 1024), np.float32), black) for name, veil in veils.items()}
        contrast = {(name, p): _contrast(veil, rows, p, black) for name, veil in veils.items() for p in PERIODS_PX}
        for u, v in PIXELS:
            what = f"{per_m:g}/m, n {index:g}, at {u},{v}"
            tally = follow(rays[v, u], stage.lamp, particles, per_m, END_Z_MM, np.array(PERIODS_PX), PHOTONS, seed=1)
            more, made = tally.white[1] / tally.white[0], float(white["all"][v, u]) * veils["all"].unit_mm_per_sr
            # A turn by less than the photons know is none for them: their single scattering has a little more light.
            yield Measured(f"{what}: photons, all over single", more, "", spread=_around(more, tally.errors[0] * more))
            yield Measured(f"{what}: simulator over photons", made / tally.white[1], "", at_least=0.85, at_most=1.15)
            for k, period in enumerate(PERIODS_PX):
                for order, name in enumerate(("single", "all")):
                    # The photons' light has no pixels; the simulator's are, with their lens, squares of two px.
                    drawn = tally.contrasts[order][k] * float(np.sinc(2.0 / period))
                    simulated = float(contrast[name, period][v, u])
                    said = f"{what}, {period:g} px, {name}"
                    spread = _around(drawn, tally.errors[1][k]) if order else None
                    yield Measured(f"{said}: photons' contrast", drawn, "", spread=spread)
                    yield Measured(
                        f"{said}: simulator's less photons'", simulated - drawn, "", at_least=-0.06, at_most=0.06
                    )


def _contrast(veil: Veil, coordinate: NDArray[np.float64], period_px: float, ends_mm: NDArray[np.float64]) -> Picture:
    """Return the share of the contrast of fringes that the veil keeps, at each pixel."""
    shifted = []
    for k in range(4):
        wave = 0.5 + 0.5 * np.cos(2.0 * math.pi * coordinate / period_px - 0.5 * math.pi * k)
        shifted.append(veil.seen(np.ascontiguousarray(np.broadcast_to(wave, (768, 1024)), np.float32), ends_mm))
    mean = np.maximum(sum(shifted), 1e-9)
    return np.asarray(2.0 * np.hypot(shifted[0] - shifted[2], shifted[1] - shifted[3]) / mean, np.float32)


def _around(value: float, error: float) -> tuple[float, float]:
    return value - error, value + error
