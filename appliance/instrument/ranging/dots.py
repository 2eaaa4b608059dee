"""Search for one pointer's dot in one image, along the curve where its beam is seen.

A dot is brighter than everything around it at a distance of four of its sigmas. That distinguishes it from edges,
stripes and squares, and from the streak of the beam in turbid water, which is equally bright on one side of the dot.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.instrument.ranging.beams import PointerBeam, RigFrame
from appliance.measure import STANDARD, HousedCamera, WorkingVolume

Array = NDArray[np.float64]

COARSE_PX = 400
"""Width of the image in which dots are searched; larger ones are averaged down to it."""
_NEAREST_MM, _FARTHEST_MM = 350.0, 720.0
_DEPTH_STEP_MM = 2.0
BAND_SIGMAS = 3.5
BAND_PX = 2.0
"""Additional half width of the searched band, in coarse px, for a dot's size and texture."""
CORE_PX = 1.2
"""Gaussian sigma of the smoothing before the search, in coarse px; a dot has about 1.5."""
RING_PX = 6
LEAST_CONTRAST_DN = 7.0
MOST = 4
"""Most candidates per image and beam."""
CENTRE_TIMES = 3
CENTRE_LEVEL = 0.25
"""Share of the height over the background from which a pixel counts for the centre."""
EDGE_PX = RING_PX + 2


@dataclass(frozen=True, slots=True)
class Candidate:
    """A spot that may be a dot."""

    u_px: float
    v_px: float
    """Row of the centre, in px of the full image."""
    contrast_dn: float
    """Grey value of the dot minus the brightest around it."""


def dot_range_mm(volume: WorkingVolume) -> tuple[float, float]:
    """Return the range of depths in the rig frame in which dots are searched; it exceeds the volume."""
    return volume.scaled(_NEAREST_MM), volume.scaled(_FARTHEST_MM)


def dot_depths_mm(volume: WorkingVolume) -> Array:
    """Return depths (n,) over that range, so close that a beam is straight between two of them."""
    return np.arange(*dot_range_mm(volume), volume.scaled(_DEPTH_STEP_MM))


class Lane:
    """The part of one camera's image in which one beam's dot can be."""

    def __init__(
        self,
        camera: HousedCamera,
        frame: RigFrame,
        water_index: float,
        beam: PointerBeam,
        volume: WorkingVolume = STANDARD,
    ) -> None:
        self._step = step = max(1, camera.width_px // COARSE_PX)
        z = dot_depths_mm(volume)
        curve = camera.project(frame.to_left(beam.at(z)), water_index)
        # px per mm across the beam, from a neighbouring line, so that no pinhole is assumed.
        aside = camera.project(frame.to_left(beam.at(z) + np.array([0.0, 1.0, 0.0])), water_index)
        px_per_mm = np.linalg.norm(aside - curve, axis=1) / step
        curve = (curve + 0.5) / step - 0.5
        half = BAND_SIGMAS * beam.sd_mm(z) * px_per_mm + BAND_PX
        h, w = camera.height_px // step, camera.width_px // step
        inside = np.isfinite(curve).all(axis=1)
        inside &= (curve > -half[:, None]).all(axis=1) & (curve < (w, h) + half[:, None]).all(axis=1)
        curve, half = curve[inside], half[inside]
        self._empty = len(curve) == 0
        if self._empty:
            return
        low = np.floor((curve - half[:, None]).min(axis=0)).astype(int) - EDGE_PX
        high = np.ceil((curve + half[:, None]).max(axis=0)).astype(int) + EDGE_PX + 1
        self._x0, self._y0 = (int(v) for v in np.maximum(low, 0))
        self._x1, self._y1 = (int(v) for v in np.minimum(high, (w, h)))
        self._band = np.zeros((self._y1 - self._y0, self._x1 - self._x0), np.bool_)
        x = np.arange(self._x0, self._x1)
        for row, inside_row in enumerate(self._band):
            off = np.hypot(x[:, None] - curve[:, 0], self._y0 + row - curve[:, 1]) - half
            inside_row[:] = (off <= 0.0).any(axis=1)
        # A ring must fit around a dot, so the border of the image is left out.
        for edge, rim in (
            (self._x0 == 0, np.s_[:, :EDGE_PX]),
            (self._x1 == w, np.s_[:, -EDGE_PX:]),
            (self._y0 == 0, np.s_[:EDGE_PX]),
            (self._y1 == h, np.s_[-EDGE_PX:]),
        ):
            if edge:
                self._band[rim] = False

    def candidates(self, image: NDArray[np.uint8]) -> list[Candidate]:
        """Return the candidates in ``image`` (h, w) uint8, by decreasing contrast; at most ``MOST``."""
        if self._empty:
            return []
        s = self._step
        part = image[self._y0 * s : self._y1 * s, self._x0 * s : self._x1 * s]
        size = (self._x1 - self._x0, self._y1 - self._y0)
        coarse = cv2.resize(part, size, interpolation=cv2.INTER_AREA) if s > 1 else part
        contrast = np.where(self._band, contrast_of(coarse), -np.inf)
        dots: list[Candidate] = []
        for _ in range(MOST):
            row, column = divmod(int(np.argmax(contrast)), size[0])
            best = float(contrast[row, column])
            if best < LEAST_CONTRAST_DN:
                break
            u, v = _centre(image, (self._x0 + column + 0.5) * s - 0.5, (self._y0 + row + 0.5) * s - 0.5, s)
            # Its surroundings are left out from now on: the flank of a dot is not a second one.
            dots.append(Candidate(u, v, best))
            contrast[
                max(0, row - RING_PX) : row + RING_PX + 1, max(0, column - RING_PX) : column + RING_PX + 1
            ] = -np.inf
        return dots


def contrast_of(coarse: NDArray[Any]) -> NDArray[np.float32]:
    """Return for each pixel (h, w) by how much it exceeds the brightest pixel on a ring around it.

    ``coarse``: an image of about ``COARSE_PX`` width.
    """
    # A dot is surrounded by darkness; around an edge or a bright area the ring has equally bright pixels.
    smooth = cv2.GaussianBlur(coarse.astype(np.float32), (0, 0), CORE_PX)
    return np.asarray(smooth - cv2.dilate(smooth, _ring()), np.float32)


def _ring() -> NDArray[np.uint8]:
    y, x = np.mgrid[-RING_PX : RING_PX + 1, -RING_PX : RING_PX + 1]
    return np.asarray(np.abs(np.hypot(x, y) - RING_PX) <= 0.6, np.uint8)


def _centre(image: NDArray[np.uint8], u: float, v: float, step: int) -> tuple[float, float]:
    """Return the centre of mass of the bright pixels around (u, v), less the background.

    Saturated grey values count as they are.
    """
    radius = (RING_PX - 1) * step
    for _ in range(CENTRE_TIMES):
        x0, y0 = max(0, round(u) - radius), max(0, round(v) - radius)
        part = image[y0 : y0 + 2 * radius + 1, x0 : x0 + 2 * radius + 1].astype(np.float32)
        yy, xx = np.ogrid[y0 : y0 + part.shape[0], x0 : x0 + part.shape[1]]
        away2 = (xx - u) ** 2 + (yy - v) ** 2
        # The median of the rim is the background even if part of it is bright.
        ground = float(np.median(part[away2 > (0.75 * radius) ** 2]))
        weight = part - ground - CENTRE_LEVEL * (float(part[away2 <= step * step].mean()) - ground)
        weight[(weight < 0.0) | (away2 > radius * radius)] = 0.0
        total = float(weight.sum())
        if total <= 0.0:
            break
        u, v = float((weight * xx).sum()) / total, float((weight * yy).sum()) / total
    return u, v
