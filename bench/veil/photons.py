"""Photon Monte Carlo of the backscatter along one camera ray: all orders of scattering, any angle.

Photons run backwards along the camera's ray and are scattered by the full phase function. At each scattering the
projector's light is added straight from its port (next event estimation). So all orders before, at and after the
backward turn are included.
"""

# Symbols in the kernel:
#   p, d      place and direction (away from the camera) of the photon; weight what is left of it
#   l         direction of the projector's light at p; u, v pattern coordinate there
#   tally     (2, 1 + 2 periods): sums over white light and over fringes (cosine, sine) in rows; of the first scattering, and of all

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from hw_sim.optics.geometry import MIDDLE_MM, Lamp
from hw_sim.optics.shadow import nearest
from hw_sim.optics.trace import HEIGHT, WIDTH, project_point
from hw_sim.water.particles import Particles

Array = NDArray[np.float64]

LEAST_DEG = 0.05
"""A turn by less is none: it moves light by 0.4 mm over the whole way, a tenth of the finest fringe."""
MOST_ORDERS = 40
NEAREST_MM = 36.0
"""Photons that come back to the windows are gone."""


@dataclass(frozen=True, slots=True)
class Tally:
    """The light that one ray brings, per unit of b (1/mm): white, and the contrast of fringes, of single scattering and of all."""

    white: tuple[float, float]
    contrasts: tuple[tuple[float, ...], tuple[float, ...]]
    errors: tuple[float, tuple[float, ...]]
    """Standard errors of all light's white (relative) and of its contrasts."""


def follow(
    ray: Array, lamp: Lamp, particles: Particles, attenuation_per_m: float, end_z_mm: float, periods_px: Array,
    photons: int, seed: int, batches: int = 16,
) -> Tally:  # fmt: skip
    """Return the backscatter along ``ray`` before a black plane at ``end_z_mm``, with fringes of ``periods_px`` in
    rows."""
    angles = np.geomspace(math.radians(LEAST_DEG), math.pi, 6000)
    phase = particles.phase(angles)
    weight = 2.0 * math.pi * phase * np.sin(angles)
    grown = np.concatenate([[0.0], np.cumsum(0.5 * (weight[1:] + weight[:-1]) * np.diff(angles))])
    # Deflections below LEAST_DEG do not count as scattering: b shrinks by their share, and so does c.
    share = particles.scattering_share * float(grown[-1])
    scattering = share * attenuation_per_m / 1000.0
    extinction = (1.0 - particles.scattering_share + share) * attenuation_per_m / 1000.0
    tallies = np.zeros((batches, 2, 1 + 2 * len(periods_px)))
    quantiles = np.interp(np.linspace(0.0, 1.0, 20_001), grown / grown[-1], angles)
    for batch in range(batches):
        _follow(
            np.ascontiguousarray(ray), lamp.eye, lamp.window, lamp.depth_mm, extinction, scattering, np.log(angles),
            phase / grown[-1], quantiles, end_z_mm, periods_px, photons // batches, 1000 * seed + batch, tallies[batch],
        )  # fmt: skip
    tallies /= photons // batches
    tallies /= particles.scattering_share * attenuation_per_m / 1000.0
    mean = tallies.mean(axis=0)
    batch_tallies = tallies[:, 1]
    contrasts = np.hypot(mean[:, 1::2], mean[:, 2::2]) / mean[:, :1]
    by_batch = np.hypot(batch_tallies[:, 1::2], batch_tallies[:, 2::2]) / batch_tallies[:, :1]
    root = math.sqrt(batches - 1)
    return Tally(
        (float(mean[0, 0]), float(mean[1, 0])),
        (tuple(contrasts[0].tolist()), tuple(contrasts[1].tolist())),
        (float(batch_tallies[:, 0].std() / root / mean[1, 0]), tuple((by_batch.std(axis=0) / root).tolist())),
    )


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _at(log_angles: Array, phase: Array, cosine: float) -> float:
    """Return the phase function at an angle, as at LEAST_DEG below it."""
    angle = math.acos(min(max(cosine, -1.0), 1.0))
    if angle <= 0.0:
        return float(phase[0])
    step = log_angles[1] - log_angles[0]
    place = (math.log(angle) - log_angles[0]) / step
    if place <= 0.0:
        return float(phase[0]) if place > -1.0 else 0.0
    i = min(int(place), phase.size - 2)
    return float(phase[i] + (place - i) * (phase[i + 1] - phase[i]))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _turned(dx: float, dy: float, dz: float, angle: float, around: float) -> tuple[float, float, float]:
    """Return a unit direction at ``angle`` from d, with azimuth ``around``."""
    # Two directions across d, from whichever axis is farther from it.
    if abs(dz) < 0.9:
        ax, ay, az = -dy, dx, 0.0
    else:
        ax, ay, az = 0.0, -dz, dy
    norm = math.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / norm, ay / norm, az / norm
    b_x, b_y, b_z = dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax
    s, c = math.sin(angle), math.cos(angle)
    a, b = s * math.cos(around), s * math.sin(around)
    return c * dx + a * ax + b * b_x, c * dy + a * ay + b * b_y, c * dz + a * az + b * b_z


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _follow(
    ray: Array, lamp: Array, window: NDArray[np.float32], depth_mm: float, extinction: float, scattering: float,
    log_angles: Array, phase: Array, quantiles: Array, end_z: float, periods: Array, photons: int, seed: int, tally: Array,
) -> None:  # fmt: skip
    np.random.seed(seed)
    for _ in range(photons):
        px, py, pz, dx, dy, dz = ray[0], ray[1], ray[2], ray[3], ray[4], ray[5]
        weight = 1.0
        for order in range(MOST_ORDERS):
            # Free path of extinction; what is not scattered there is absorbed.
            s = -math.log(1.0 - np.random.random()) / extinction
            px, py, pz = px + s * dx, py + s * dy, pz + s * dz
            if pz > end_z or pz < NEAREST_MM or abs(px) > 600.0 or abs(py) > 600.0:
                break
            weight *= scattering / extinction
            if weight < 1e-14:
                break
            u, v = project_point(lamp, px, py, pz)
            lx, ly, lz = dx, dy, dz
            is_illuminated = not math.isnan(u) and -0.5 < u < lamp[WIDTH] - 0.5 and -0.5 < v < lamp[HEIGHT] - 0.5
            if is_illuminated:
                start = window[
                    nearest(min(max(v, 0.0), lamp[HEIGHT] - 1.0)), nearest(min(max(u, 0.0), lamp[WIDTH] - 1.0))
                ]
                lx, ly, lz = px - start[0], py - start[1], pz - start[2]
                path = math.sqrt(lx * lx + ly * ly + lz * lz)
                lx, ly, lz = lx / path, ly / path, lz / path
                # The light is turned from l to −d.
                spread = (MIDDLE_MM + depth_mm) / (path + depth_mm)
                light = _at(log_angles, phase, -(lx * dx + ly * dy + lz * dz))
                light *= weight * spread * spread * start[3] * math.exp(-extinction * path)
                for which in range(2):
                    if which == 0 and order > 0:
                        continue
                    tally[which, 0] += light
                    for k in range(periods.size):
                        wave = 2.0 * math.pi * v / periods[k]
                        tally[which, 1 + 2 * k] += light * math.cos(wave)
                        tally[which, 2 + 2 * k] += light * math.sin(wave)
            # Next direction: half of them as scattered, half towards the projector's window, where the light comes from;
            # the weight makes up for it (balance heuristic).
            angle = quantiles[int(np.random.random() * (quantiles.size - 1))]
            around = 2.0 * math.pi * np.random.random()
            if is_illuminated and np.random.random() < 0.5:
                nx, ny, nz = _turned(-lx, -ly, -lz, angle, around)
            else:
                nx, ny, nz = _turned(dx, dy, dz, angle, around)
            if is_illuminated:
                scatter_density = _at(log_angles, phase, nx * dx + ny * dy + nz * dz)
                source_density = _at(log_angles, phase, -(nx * lx + ny * ly + nz * lz))
                weight *= scatter_density / (0.5 * scatter_density + 0.5 * source_density)
            dx, dy, dz = nx, ny, nz
