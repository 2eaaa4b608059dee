"""Backscatter of the world ``outside``, resolved along both directions of the pattern.

It has a phase function, multiple scattering, and a projector that is out of focus in the water before the object. Along
each camera ray the pattern coordinate across the fringes runs through many of them, so that they nearly cancel; along
the other it is nearly constant, so that fringes in rows remain. Both follow from one integral along the ray. It is
taken in closed form within each step: the light is summed along its rows once, and a step takes the difference of two
sums, however many fringes it crosses.

Scattering once by a large angle, and any number of times by small ones before and after (H. R. Gordon, Appl. Opt. 12
(1973) 2803, quasi-single scattering): light spreads on its path from the projector by ``particles.Transfer``, at each
depth by its own; on the path to the camera a part keeps its direction and the remainder is a glow.
"""

# Symbols in the kernels:
#   s         length along a camera ray, mm, at NODES nodes whose logarithms are equally far apart; far, the surface's
#   u, v      pattern coordinate at a node, in px of the shrunk light; level: its depth in the stack of softened light
#   sharp     light from 1 mm of water at a node that keeps its direction; wide light scattered by small angles
#   sums      the stack's light, summed along its rows up to each column's left edge

from __future__ import annotations

import math

import cv2
import numba
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from hw_sim.optics.geometry import MIDDLE_MM, Lamp
from hw_sim.optics.projector import defocus_px
from hw_sim.optics.shadow import nearest
from hw_sim.optics.trace import FOCAL, HEIGHT, WATER, WIDTH, project_point
from hw_sim.water.particles import Particles, Transfer
from hw_sim.water.spread import fast_length

Array = NDArray[np.float64]
Picture = NDArray[np.float32]

FIRST_MM, LAST_MM, NODES = 60.0, 1000.0, 112
"""Range of the integral along camera rays, and its nodes."""
ROW_PX, COLUMN_PX = 4, 8
"""Lattice of camera rays that is integrated, px of 1600: a fringe of 16 projector px is 25 px high in the picture."""
PLACES = 33
"""Camera rays in each direction with exact pattern coordinates; others are interpolated, to 0.02 px."""
SHRINK = 2
"""Edge, projector px, of the squares over which the light is averaged: like pixel and lens, 1/3 px² of variance."""
LEVELS = 9
"""Depths at which the light's softness is computed."""
GLOW_PX = 40.0
"""Gaussian sigma, px of 1600, of backscatter that is scattered again on its path to the camera."""
FRINGE_DEG = 0.48
"""Period of a fringe of 16 projector px in the image. Light that no longer carries it to the camera counts as glow."""
BORDER = 0.25
"""Dark border around the light, as a share of its size, so that the halo does not wrap around."""


class Veil:
    """The backscatter in one camera of a rig, at rest or in motion: the beam moves with the camera.

    ``rays`` (h, w, 6) are the camera's; ``defocus``: the projector has a focus to lose.
    """

    def __init__(
        self, rays: Array, lamp: Lamp, particles: Particles, attenuation_per_m: float, defocus: bool = True
    ) -> None:
        h, w = rays.shape[:2]
        self._shape = (h, w)
        self._rows = _lattice(h, max(1, round(ROW_PX * w / 1600.0)))
        self._columns = _lattice(w, max(1, round(COLUMN_PX * w / 1600.0)))
        self._lengths_mm = np.geomspace(FIRST_MM, LAST_MM, NODES)
        places_y, places_x = (np.unique(np.rint(np.linspace(0, n - 1, min(PLACES, n))).astype(int)) for n in (h, w))
        self._at = _within(self._rows, places_y), _within(self._columns, places_x)
        coarse = np.ascontiguousarray(rays[np.ix_(places_y, places_x)])
        self._levels_mm = np.geomspace(0.8 * FIRST_MM, 1.2 * LAST_MM, LEVELS)
        transfer = Transfer(particles, attenuation_per_m)
        angles = np.radians(np.arange(0.5, 181.0))
        phase = np.ascontiguousarray(particles.phase(angles))
        unscattered, total = _camera_way(transfer, self._lengths_mm)
        per_mm = attenuation_per_m / 1000.0
        self._places = np.empty((*coarse.shape[:2], NODES, 5), np.float32)
        _places(
            coarse, self._lengths_mm, lamp.eye, lamp.window, lamp.depth_mm, per_mm, phase, unscattered, total,
            self._levels_mm, self._places,
        )  # fmt: skip
        self._unit = _unit(rays[h // 2, w // 2], lamp, phase)
        """White light, scattered once, from perfectly clear water before the middle on the middle ray."""
        self._width, self._height = int(lamp.eye[WIDTH]), int(lamp.eye[HEIGHT])
        self._filters = self._softening(transfer, lamp, defocus)

    @property
    def unit_mm_per_sr(self) -> float:
        """Unit of ``seen``: ∫ p(θ) E ds of clear white water before the middle on the middle ray."""
        return self._unit

    def seen(self, light: Picture, distance_mm: Array) -> Picture:
        """Return the backscatter (h, w) float32 of the projected ``light`` (768, 1024).

        Surfaces lie at ``distance_mm`` (h, w; NaN: none). The unit is the middle ray's backscatter of white light, as
        in ``backscatter.Backscatter``.
        """
        ends = np.ascontiguousarray(distance_mm[np.ix_(self._rows, self._columns)])
        coarse = np.zeros((2, *ends.shape), np.float32)
        _gather(self._places, self._lengths_mm, *self._at, ends, self._sums(light), coarse)
        sharp, glow = coarse / np.float32(self._unit)
        scale = self._shape[1] / 1600.0
        spread = (
            GLOW_PX * scale / (self._columns[1] - self._columns[0]),
            GLOW_PX * scale / (self._rows[1] - self._rows[0]),
        )
        glow = cv2.GaussianBlur(glow, (0, 0), spread[0], sigmaY=spread[1], borderType=cv2.BORDER_REPLICATE)
        return self._enlarged(np.asarray(sharp + glow, np.float32))

    def _enlarged(self, coarse: Picture) -> Picture:
        """Return the lattice's values at all pixels, by cubic interpolation."""
        h, w = self._shape
        first_x, first_y = float(self._columns[0]), float(self._rows[0])
        step_x, step_y = float(self._columns[1]) - first_x, float(self._rows[1]) - first_y
        if step_x == step_y == 1.0:
            return coarse
        # warpAffine's inverse map: place in the lattice = (pixel − first) / step.
        to_lattice = np.array([[1.0 / step_x, 0.0, -first_x / step_x], [0.0, 1.0 / step_y, -first_y / step_y]])
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        return np.asarray(
            cv2.warpAffine(coarse, to_lattice, (w, h), flags=flags, borderMode=cv2.BORDER_REPLICATE), np.float32
        )

    def _softening(self, transfer: Transfer, lamp: Lamp, defocus: bool) -> list[Picture]:
        """Return for each level the factors of the light's spectrum: water and the projector's defocus."""
        size = self._spectrum_size()
        fy = np.abs(scipy.fft.fftfreq(size[0], SHRINK))[:, None]
        fx = scipy.fft.rfftfreq(size[1], SHRINK)[None]
        wave_per_px = 2.0 * math.pi * np.hypot(fy, fx)
        # Linear interpolation between rows softens by sinc²; that is compensated here, but not for the finest stripes.
        between_rows = np.maximum(np.sinc(SHRINK * fy) ** 2, 0.6)
        factors = []
        for way_mm in self._levels_mm:
            # A px is an angle of 1 / (f n) from the apparent source.
            px_mm = (way_mm + lamp.depth_mm) / float(lamp.eye[FOCAL] * lamp.eye[WATER])
            sigma_px = float(defocus_px(way_mm, lamp.depth_mm)) if defocus else 0.0
            blur = np.exp(-0.5 * (wave_per_px * sigma_px) ** 2) / between_rows
            factors.append(np.asarray(blur * transfer(way_mm, wave_per_px / px_mm), np.float32))
        return factors

    def _spectrum_size(self) -> tuple[int, int]:
        return fast_length(self._height // SHRINK, BORDER), fast_length(self._width // SHRINK, BORDER)

    def _sums(self, light: Picture) -> Picture:
        """Return the stack of softened light, summed along its rows: (LEVELS, rows, columns + 1) float32."""
        rows, columns = self._height // SHRINK, self._width // SHRINK
        small = cv2.resize(light, (columns, rows), interpolation=cv2.INTER_AREA)
        spectrum = scipy.fft.rfft2(np.asarray(small, np.float32), self._spectrum_size())
        sums = np.zeros((LEVELS, rows, columns + 1), np.float32)
        for level, factor in enumerate(self._filters):
            soft = scipy.fft.irfft2(spectrum * factor, self._spectrum_size())[:rows, :columns]
            np.cumsum(soft, axis=1, out=sums[level, :, 1:])
        return sums


def _lattice(size: int, step: int) -> NDArray[np.int64]:
    """Return rows or columns, ``step`` apart, in the middle of as many cells as fit."""
    return np.arange((size - 1) % step // 2, size, step)


def _within(lattice: NDArray[np.int64], places: NDArray[np.int64]) -> Array:
    """Return the position of each row or column of the lattice among the places: integer part and fraction."""
    return np.interp(lattice, places, np.arange(len(places), dtype=np.float64))


def _camera_way(transfer: Transfer, lengths_mm: Array) -> tuple[Array, Array]:
    """Return, for each length of the path to the camera, the factors of unscattered light and of all light."""
    # κ s of a fringe is 2π over its angle for every path, as both grow with it.
    wave = 2.0 * math.pi / math.radians(FRINGE_DEG)
    unscattered = np.array([float(transfer(s, np.array(wave / s))) for s in lengths_mm])
    total = np.array([float(transfer(s, np.array(0.0))) for s in lengths_mm])
    return unscattered, total


def _unit(ray: Array, lamp: Lamp, phase: Array) -> float:
    """Return ∫ p(θ) E ds along ``ray`` through clear white water before the middle."""
    lengths_mm = np.linspace(FIRST_MM, MIDDLE_MM, 400)
    ones = np.ones(400)
    places = np.empty((1, 1, 400, 5), np.float32)
    _places(
        ray[None, None], lengths_mm, lamp.eye, lamp.window, lamp.depth_mm, 0.0, phase, ones, ones,
        np.array([1.0, 2000.0]), places,
    )  # fmt: skip
    u, v, light = places[0, 0, :, 0], places[0, 0, :, 1], places[0, 0, :, 2].astype(np.float64)
    is_lit = (u > 0.0) & (u < lamp.eye[WIDTH] / SHRINK) & (v > 0.0) & (v < lamp.eye[HEIGHT] / SHRINK)
    return float(np.trapezoid(np.where(is_lit, light, 0.0), lengths_mm))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _places(
    rays: Array, lengths: Array, lamp: Array, window: Picture, depth_mm: float, per_mm: float, phase: Array,
    unscattered: Array, total: Array, levels: Array, out: Picture,
) -> None:  # fmt: skip
    """Fill ``out`` (rows, columns, NODES, 5) with u, v, sharp, wide and level of each ray at each length."""
    step = math.log(levels[1] / levels[0])
    for y in range(rays.shape[0]):
        for x in range(rays.shape[1]):
            ray = rays[y, x]
            for k in range(lengths.size):
                s, place = lengths[k], out[y, x, k]
                px, py, pz = ray[0] + s * ray[3], ray[1] + s * ray[4], ray[2] + s * ray[5]
                u, v = project_point(lamp, px, py, pz)
                if math.isnan(u):
                    # Behind the projector's port: far outside of its image.
                    place[0], place[1], place[2], place[3], place[4] = -1e4, -1e4, 0.0, 0.0, 0.0
                    continue
                a, b = min(max(u, 0.0), lamp[WIDTH] - 1.0), min(max(v, 0.0), lamp[HEIGHT] - 1.0)
                start = window[nearest(b), nearest(a)]
                dx, dy, dz = px - start[0], py - start[1], pz - start[2]
                path = math.sqrt(dx * dx + dy * dy + dz * dz)
                # The light goes along d / path and leaves against the camera's ray: cos θ = −(d · ray) / path.
                cosine = -(dx * ray[3] + dy * ray[4] + dz * ray[5]) / path
                turned = math.degrees(math.acos(min(max(cosine, -1.0), 1.0))) - 0.5
                i = min(max(int(turned), 0), phase.size - 2)
                scattered = phase[i] + (turned - i) * (phase[i + 1] - phase[i])
                # Inverse squares from the apparent source, the lamp's field, Beer and Lambert on both paths.
                spread = (MIDDLE_MM + depth_mm) / (path + depth_mm)
                light = scattered * spread * spread * start[3] * math.exp(-per_mm * (path + s))
                # Pixel centres at integers; a column's left edge is the place of its sum.
                place[0], place[1] = (u + 0.5) / SHRINK, (v + 0.5) / SHRINK
                place[2], place[3] = light * unscattered[k], light * (total[k] - unscattered[k])
                place[4] = min(max(math.log(path / levels[0]) / step, 0.0), levels.size - 1.002)


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _summed(sums: Picture, level: int, j: int, t: np.float32, u: np.float32) -> np.float32:
    """Return the light of a level left of column ``u`` in row j + t."""
    columns = sums.shape[2] - 1
    u = min(max(u, np.float32(0.0)), np.float32(columns) - np.float32(1e-3))
    i = int(u)
    r = u - np.float32(i)
    upper = sums[level, j, i] + r * (sums[level, j, i + 1] - sums[level, j, i])
    lower = sums[level, j + 1, i] + r * (sums[level, j + 1, i + 1] - sums[level, j + 1, i])
    return np.float32(upper + t * (lower - upper))


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _gather(
    places: Picture, lengths: Array, at_y: Array, at_x: Array, ends: Array, sums: Picture, out: Picture
) -> None:
    """Fill ``out`` (2, rows, columns) with the returning light of each ray: sharp, and glow."""
    half, rows = np.float32(0.5), sums.shape[1]
    last = np.float32(sums.shape[2] - 1) - np.float32(1e-3)
    line = np.empty((places.shape[1], places.shape[2], 5), np.float32)
    for y in range(ends.shape[0]):
        # The places of this row of the lattice, between two rows of exact ones.
        m = min(int(at_y[y]), places.shape[0] - 2)
        share = np.float32(at_y[y] - m)
        for p in range(line.shape[0]):
            for k in range(line.shape[1]):
                for c in range(5):
                    line[p, k, c] = places[m, p, k, c] + share * (places[m + 1, p, k, c] - places[m, p, k, c])
        for x in range(ends.shape[1]):
            n = min(int(at_x[x]), line.shape[0] - 2)
            share = np.float32(at_x[x] - n)
            far = ends[y, x]
            sharp, glow = np.float32(0.0), np.float32(0.0)
            u0, v0, a0, w0, l0 = np.float32(0), np.float32(0), np.float32(0), np.float32(0), np.float32(0)
            for k in range(lengths.size):
                left, right = line[n, k], line[n + 1, k]
                u1, v1 = left[0] + share * (right[0] - left[0]), left[1] + share * (right[1] - left[1])
                a1, w1 = left[2] + share * (right[2] - left[2]), left[3] + share * (right[3] - left[3])
                l1 = left[4] + share * (right[4] - left[4])
                if k > 0:
                    length = lengths[k] - lengths[k - 1]
                    # The surface cuts this step: only the part before it counts, to the fraction of a fringe.
                    cut = np.float32(1.0)
                    if far < lengths[k]:
                        cut = np.float32((far - lengths[k - 1]) / length)
                        if cut <= np.float32(0.0):
                            break
                    end = u0 + cut * (u1 - u0)
                    v = v0 + half * cut * (v1 - v0) - half
                    # Outside of the projector's image it is dark: sums on both sides of it are equal.
                    beside = max(u0, end) <= np.float32(0.0) or min(u0, end) >= last
                    if not beside and v > -half and v < np.float32(rows) - half:
                        v = min(max(v, np.float32(0.0)), np.float32(rows) - np.float32(1.002))
                        j = int(v)
                        t = v - np.float32(j)
                        level = l0 + half * cut * (l1 - l0)
                        i = int(level)
                        r = level - np.float32(i)
                        run = end - u0
                        # Mean light of the step: difference of sums over its columns, between two levels.
                        if abs(run) < np.float32(0.02):
                            run = np.float32(0.02)
                        one_sum = _summed(sums, i, j, t, u0 + run) - _summed(sums, i, j, t, u0)
                        other_sum = _summed(sums, i + 1, j, t, u0 + run) - _summed(sums, i + 1, j, t, u0)
                        mean = (one_sum + r * (other_sum - one_sum)) / run * cut * np.float32(length)
                        sharp += mean * (a0 + half * cut * (a1 - a0))
                        glow += mean * (w0 + half * cut * (w1 - w0))
                    if cut < np.float32(1.0):
                        break
                u0, v0, a0, w0, l0 = u1, v1, a1, w1, l1
            out[0, y, x], out[1, y, x] = sharp, glow
