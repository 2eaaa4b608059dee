"""The gloss of wet paint and shell in the world ``outside``: projector light reflected into a camera.

R. L. Cook and K. E. Torrance, ACM Trans. Graph. 1 (1982) 7: facets with Beckmann's distribution of slopes, Fresnel's
reflection on each, and their mutual shadowing.
"""

# Symbols:
#   n, l, e   unit normal, unit directions to the light and to the eye; b the direction half way between l and e
#   m         root mean square slope; D density of facets whose normal is b, F reflection of each, G what is not shaded

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from hw_sim.objects.finish import Finish
from hw_sim.objects.shapes import gradient
from hw_sim.optics.geometry import GREY, LIT, Geometry, Lamp, P, Pose, Q
from hw_sim.optics.shadow import into, nearest
from hw_sim.optics.trace import HEIGHT, WIDTH

Array = NDArray[np.float64]


@numba.njit(nogil=True, cache=True, error_model="numpy")
def fresnel(cosine: float, index: float) -> float:
    """Return the reflection of unpolarised light at a medium of relative ``index`` ≥ 1."""
    # c = cos of incidence, g² = n² − 1 + c².
    g = math.sqrt(index * index - 1.0 + cosine * cosine)
    ratio = (g - cosine) / (g + cosine)
    second_factor = (cosine * (g + cosine) - 1.0) / (cosine * (g - cosine) + 1.0)
    return 0.5 * ratio * ratio * (1.0 + second_factor * second_factor)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def glossy(to_light: float, to_eye: float, half: float, apart: float, m: float, index: float) -> float:
    """Return the reflected radiance towards the eye, 1/sr per irradiance.

    The arguments are the cosines of l and of e against the normal, of b against the normal (``half``), and of b against
    l (``apart``).
    """
    if to_light <= 0.0 or to_eye <= 0.0 or half <= 0.0:
        return 0.0
    square = half * half
    # Beckmann: D = exp(−tan²δ / m²) / (π m² cos⁴δ).
    density = math.exp(-(1.0 - square) / (square * m * m)) / (math.pi * m * m * square * square)
    shade = min(1.0, min(2.0 * half * to_eye / apart, 2.0 * half * to_light / apart))
    return density * fresnel(apart, index) * shade / (4.0 * to_light * to_eye)


def finish(geometry: Geometry, rays: Array, pose: Pose, lamp: Lamp, coat: Finish, attenuation_per_m: float) -> None:
    """Apply a finish to the reflected light of each pixel of ``geometry``: its white, and its gloss."""
    geometry.pixels[..., [LIT, GREY]] *= np.float32(coat.whiter)
    if coat.gloss_index > 1.0:
        _shine(
            pose.kind, pose.sizes, pose.R, pose.t, rays, geometry.distance_mm, lamp.eye, lamp.window, coat.roughness,
            coat.gloss_index, attenuation_per_m / 1000.0, geometry.pixels,
        )  # fmt: skip


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _shine(
    kind: int, sizes: Array, R: Array, t: Array, rays: Array, distance: Array, lamp: Array,
    window: NDArray[np.float32], m: float, index: float, per_mm: float, pixels: NDArray[np.float32],
) -> None:  # fmt: skip
    for y in range(distance.shape[0]):
        for x in range(distance.shape[1]):
            out = pixels[y, x]
            if not out[LIT] > 0.0 or not out[GREY] > 0.0:
                continue
            ray, far = rays[y, x], distance[y, x]
            ox, oy, oz = into(R, ray[0] - t[0], ray[1] - t[1], ray[2] - t[2])
            dx, dy, dz = into(R, ray[3], ray[4], ray[5])
            hx, hy, hz = ox + far * dx, oy + far * dy, oz + far * dz
            u, v = min(max(out[P], 0.0), lamp[WIDTH] - 1.0), min(max(out[Q], 0.0), lamp[HEIGHT] - 1.0)
            start = window[nearest(v), nearest(u)]
            lx, ly, lz = into(R, start[0] - t[0], start[1] - t[1], start[2] - t[2])
            lx, ly, lz = lx - hx, ly - hy, lz - hz
            length = math.sqrt(lx * lx + ly * ly + lz * lz)
            lx, ly, lz = lx / length, ly / length, lz / length
            nx, ny, nz = gradient(kind, sizes, hx, hy, hz)
            norm = math.sqrt(nx * nx + ny * ny + nz * nz) + 1e-12
            nx, ny, nz = nx / norm, ny / norm, nz / norm
            # Half way between the light and the eye, which is where the ray comes from.
            bx, by, bz = lx - dx, ly - dy, lz - dz
            norm = math.sqrt(bx * bx + by * by + bz * bz) + 1e-12
            bx, by, bz = bx / norm, by / norm, bz / norm
            sent = glossy(
                lx * nx + ly * ny + lz * nz, -(dx * nx + dy * ny + dz * nz), bx * nx + by * ny + bz * nz,
                bx * lx + by * ly + bz * lz, m, index,
            )  # fmt: skip
            # A Lambertian surface sends ρ / π; GREY is ρ times what the water leaves on the way.
            albedo = out[GREY] * math.exp(per_mm * far)
            out[LIT] = out[LIT] * (1.0 + math.pi * sent / albedo)
