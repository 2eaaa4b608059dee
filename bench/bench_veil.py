"""Backscatter of the harsher world against a photon Monte Carlo: single rays, all orders of scattering."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.result import Measurement
from bench.veil.photons import follow
from bench.veil.table import PERIODS_PX, RayBackscatter, write_page
from hw_sim.rendering.stage import Stage
from hw_sim.truth import draw_truth
from hw_sim.water.medium import Water
from hw_sim.water.particles import Particles
from hw_sim.water.veil import Veil

WIDTH_PX, HEIGHT_PX = 400, 300
PIXELS = ((101, 150), (201, 70), (201, 150))
"""Column and row of the rays that are followed."""
END_Z_MM = 522.5
WATERS = ((1.0, 0.7, 1.10, 3.5835), (3.0, 0.8, 1.10, 3.5835), (3.0, 0.8, 1.06, 3.4))
"""Beam attenuation in 1/m, scattered share of it, and refractive index and size slope of the particles."""
PHOTONS = 120_000
PAGE = Path("docs/outside-world.md")
Picture = NDArray[np.float32]


def measure() -> Iterable[Measurement]:
    """Compare the simulator's veil with photons: its brightness, its excess over single scattering, and the fringes in
    rows."""
    return figures(checked())


def main(arguments: Sequence[str]) -> int:
    """Run the command line: ``./dev bench veil --help``."""
    parser = argparse.ArgumentParser(prog="./dev bench veil", description=__doc__)
    parser.add_argument("--photons", type=int, default=PHOTONS, help="along each ray; default: %(default)s")
    parser.add_argument("--write-docs", action="store_true", help=f"write the table of {PAGE}, too")
    options = parser.parse_args(arguments)
    if not 1_000 <= options.photons <= 100_000_000:
        parser.error(f"--photons {options.photons}: allowed are 1000 to 100000000")
    rows = list(checked(options.photons))
    measured = list(figures(rows))
    sys.stdout.writelines(number.line() + "\n" for number in measured)
    if options.write_docs:
        write_page(rows, PAGE)
    return 0 if all(number.is_kept for number in measured) else 1


def checked(photons: int = PHOTONS) -> Iterator[RayBackscatter]:
    """Yield photons and simulator along each of ``PIXELS`` through each of ``WATERS``."""
    stage = Stage(draw_truth("realistic", 1, WIDTH_PX, HEIGHT_PX, Water().index))
    rays = stage.rays("left")
    black = (END_Z_MM - rays[..., 2]) / rays[..., 5]
    rows = np.arange(768.0)[:, None]
    # The photons' light has no pixels; the simulator's are, with their lens, squares of two px.
    drawn = np.sinc(2.0 / np.array(PERIODS_PX))
    for per_m, share, index, slope in WATERS:
        particles = Particles(share, index, slope)
        veils = (
            Veil(rays, stage.lamp, Particles(0.0, index, slope), per_m, defocus=False),
            Veil(rays, stage.lamp, particles, per_m, defocus=False),
        )
        white = veils[1].seen(np.ones((768, 1024), np.float32), black)
        contrast = [[_contrast(veil, rows, period, black) for period in PERIODS_PX] for veil in veils]
        for u, v in PIXELS:
            tally = follow(rays[v, u], stage.lamp, particles, per_m, END_Z_MM, np.array(PERIODS_PX), photons, seed=1)
            more, simulated_light = tally.white[1] / tally.white[0], float(white[v, u]) * veils[1].unit_mm_per_sr
            single, every = (tuple(float(value) for value in np.array(values) * drawn) for values in tally.contrasts)
            simulated = [tuple(float(picture[v, u]) for picture in values) for values in contrast]
            # Deflections below the photons' limit do not count as scattering there, so that their single scattering has
            # a little more light.
            yield RayBackscatter(
                per_m, index, (u, v), more, tally.errors[0] * more, simulated_light / tally.white[1],
                (single, every), (simulated[0], simulated[1]), tally.errors[1],
            )  # fmt: skip


def figures(rows: Iterable[RayBackscatter]) -> Iterator[Measurement]:
    """Yield the figures of each ray."""
    for row in rows:
        what = f"{row.per_m:g}/m, n {row.index:g}, at {row.pixel[0]},{row.pixel[1]}"
        yield Measurement(f"{what}: photons, all over single", row.more, "", spread=_around(row.more, row.more_error))
        yield Measurement(f"{what}: simulator over photons", row.over, "", at_least=0.85, at_most=1.15)
        for k, period in enumerate(PERIODS_PX):
            for order, name in enumerate(("single", "all")):
                drawn, simulated = row.photons[order][k], row.simulated[order][k]
                label = f"{what}, {period:g} px, {name}"
                spread = _around(drawn, row.errors[k]) if order else None
                yield Measurement(f"{label}: photons' contrast", drawn, "", spread=spread)
                yield Measurement(
                    f"{label}: simulator's less photons'", simulated - drawn, "", at_least=-0.06, at_most=0.06
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
