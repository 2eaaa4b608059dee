"""Interreflection, once: corners in the world ``outside`` are brighter than by the projector alone.

The illuminated surface is cut into patches of the pattern. Each reflects its light by Lambert's law to every other
patch that faces it without an obstacle (radiosity, one bounce: C. M. Goral et al., SIGGRAPH 1984).
"""

# Symbols in the kernel:
#   i, j      patches: j sends, i receives; p place, n unit normal, in the object's frame
#   sent      light of white that j throws back: albedo × irradiance × area
#   r         distance between them; the kernel of radiosity is cos cos / (π r²)

from __future__ import annotations

import math

import cv2
import numba
import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from hw_sim.objects.shapes import gradient
from hw_sim.objects.texture import albedo
from hw_sim.optics.geometry import GREY, MIDDLE_MM, Geometry, Lamp, P, Pose, Q
from hw_sim.optics.shadow import MARGIN_PX, STEP_PX, into, shaded
from hw_sim.optics.trace import FOCAL, HEIGHT, WATER, WIDTH

Array = NDArray[np.float64]

PATCH_PX = 16
"""Side of a patch in projector px, 4 mm: finer fringes reach other places as their mean."""
LEAST = 3e-6
"""Least share of another patch's white that counts: of 3000 patches, that is a hundredth."""

LIFT_MM = 0.3
"""Height above a patch at which shadow rays start, so that its own surface is no obstacle."""


class Bounce:
    """The light that an object at one pose reflects onto itself."""

    def __init__(
        self, pose: Pose, lamp: Lamp, first: NDArray[np.float32], texture: int, lattice: NDArray[np.float32],
        whiter: float, attenuation_per_m: float,
    ) -> None:  # fmt: skip
        """``first``: the pose's shadows (``geometry.shadows``); ``whiter``: factor of all albedos."""
        self._size = int(lamp.eye[WIDTH]) // PATCH_PX, int(lamp.eye[HEIGHT]) // PATCH_PX
        width, height = self._size
        # The middle of a patch is at 7.5 px: the nearest ray of the lamp is used.
        middle = (PATCH_PX // 2 + MARGIN_PX) // STEP_PX
        every = PATCH_PX // STEP_PX
        rays = np.ascontiguousarray(lamp.map_rays[middle::every, middle::every][:height, :width].reshape(-1, 6))
        bright = lamp.window[middle::every, middle::every, 3][:height, :width].reshape(-1).astype(np.float64)
        ways = first[middle::every, middle::every][:height, :width].reshape(-1).astype(np.float64)
        angle = PATCH_PX / float(lamp.eye[FOCAL] * lamp.eye[WATER])
        factors = np.zeros((len(rays), len(rays)), np.float32)
        _exchange(
            pose.kind, pose.sizes, pose.R, pose.t, rays, ways, bright, angle, lamp.depth_mm, texture, lattice, whiter,
            attenuation_per_m / 1000.0, factors,
        )  # fmt: skip
        self._factors = scipy.sparse.csr_matrix(factors)

    def irradiance(self, light: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the light on each patch (rows, columns) float32 from the other patches.

        ``light`` (768, 1024) is projected. The unit is that of ``light`` on a white surface facing the rig in the
        middle of the volume.
        """
        patches = cv2.resize(light, self._size, interpolation=cv2.INTER_AREA)
        fallen = self._factors @ np.asarray(patches, np.float32).reshape(-1)
        return np.asarray(fallen, np.float32).reshape(self._size[::-1])

    def seen(self, light: NDArray[np.float32], geometry: Geometry) -> NDArray[np.float32]:
        """Return the interreflection in a camera's image (h, w) float32, in the units of LIT × light."""
        fallen = self.irradiance(light)
        # Patch centres lie at 7.5 px, 23.5 px, …
        positions = (geometry.pixels[..., [P, Q]] + np.float32(0.5)) / np.float32(PATCH_PX) - np.float32(0.5)
        positions = np.ascontiguousarray(np.clip(positions, -4.0, 1e3))
        fallen_px = cv2.remap(
            fallen,
            positions[..., 0],
            positions[..., 1],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=0.0,
        )
        return np.asarray(fallen_px * geometry.pixels[..., GREY], np.float32)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _exchange(
    kind: int, sizes: Array, R: Array, t: Array, rays: Array, ways: Array, bright: Array, angle: float,
    depth_mm: float, texture: int, lattice: NDArray[np.float32], whiter: float, per_mm: float,
    out: NDArray[np.float32],
) -> None:  # fmt: skip
    """Fill ``out`` (patches, patches): row i is the light from each patch of white light to patch i."""
    count = ways.size
    places, normals = np.zeros((count, 3)), np.zeros((count, 3))
    sent, area = np.zeros(count), np.zeros(count)
    for j in range(count):
        if math.isnan(ways[j]):
            continue
        ray, length_mm = rays[j], ways[j]
        ox, oy, oz = into(R, ray[0] - t[0], ray[1] - t[1], ray[2] - t[2])
        dx, dy, dz = into(R, ray[3], ray[4], ray[5])
        hx, hy, hz = ox + length_mm * dx, oy + length_mm * dy, oz + length_mm * dz
        nx, ny, nz = gradient(kind, sizes, hx, hy, hz)
        norm = math.sqrt(nx * nx + ny * ny + nz * nz) + 1e-12
        places[j, 0], places[j, 1], places[j, 2] = hx, hy, hz
        normals[j, 0], normals[j, 1], normals[j, 2] = nx / norm, ny / norm, nz / norm
        facing = -(dx * nx + dy * ny + dz * nz) / norm
        if facing <= 0.02:
            continue
        # Irradiance as in ``geometry``; the patch is as large as its angle, and larger where it leans.
        spread = (MIDDLE_MM + depth_mm) / (length_mm + depth_mm)
        area[j] = ((length_mm + depth_mm) * angle) ** 2 / facing
        light = facing * spread * spread * bright[j] * math.exp(-per_mm * length_mm)
        sent[j] = whiter * albedo(texture, lattice, hx, hy, hz) * light * area[j]
    for i in range(count):
        if area[i] == 0.0:
            continue
        for j in range(count):
            if sent[j] == 0.0 or i == j:
                continue
            x, y, z = places[j, 0] - places[i, 0], places[j, 1] - places[i, 1], places[j, 2] - places[i, 2]
            a = x * normals[i, 0] + y * normals[i, 1] + z * normals[i, 2]
            b = -(x * normals[j, 0] + y * normals[j, 1] + z * normals[j, 2])
            if a <= 0.0 or b <= 0.0:
                continue
            # A patch next to another is not a point: a disc of its area bounds the kernel.
            square = x * x + y * y + z * z
            value = sent[j] * a * b / (square * (math.pi * square + area[j])) * math.exp(-per_mm * math.sqrt(square))
            if value < LEAST:
                continue
            hidden = shaded(
                kind, sizes, places[i, 0], places[i, 1], places[i, 2], normals[i, 0], normals[i, 1], normals[i, 2],
                places[j, 0] + LIFT_MM * normals[j, 0], places[j, 1] + LIFT_MM * normals[j, 1], places[j, 2] + LIFT_MM * normals[j, 2],
            )  # fmt: skip
            if not hidden:
                out[i, j] = value
