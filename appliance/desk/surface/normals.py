"""Normals of an organised cloud, each of a plane that is fitted to the points around a pixel.

Only points on the same surface are used. A neighbour counts if a path leads to it from the middle pixel, outwards, from
pixel to pixel, without crossing a step in depth (``steps.py``).

The fit is least squares with errors along the middle pixel's ray, since a point's error lies along its ray. Symbols: u
is the ray; e and f complete it to a frame. a, b and c are a neighbour's coordinates along e, f and u, relative to the
middle point. The plane is c = c0 + s a + t b. The normal (s, t, −1) always points towards the camera.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.desk.surface.steps import Connections, connect_neighbours
from appliance.measure import OrganisedCloud

RADIUS_PX = 2
"""Half of a window's side less the middle: 5 x 5 pixels."""
LEAST_POINTS = 6
LEAST_SPREAD = 0.05
"""Least determinant of the points' spread over its largest possible value: less is a line, about which a plane could
rotate."""


def normals(cloud: OrganisedCloud, same: Connections | None = None, radius_px: int = RADIUS_PX) -> NDArray[np.float32]:
    """Return the unit normals (h, w, 3) float32 of a cloud, in its frame, towards the camera.

    NaN where unknown. ``same``: the result of ``connect_neighbours``, if it is known. Unknown are pixels without a point, and
    those with less than ``LEAST_POINTS`` around them or with all of them in a line. Raises ValueError for a window of
    less than 3 x 3 or more than 15 x 15 pixels.
    """
    if not 1 <= radius_px <= 7:
        raise ValueError(f"radius_px is {radius_px}; allowed are 1..7")
    same = connect_neighbours(cloud) if same is None else same
    out = np.full(cloud.points_mm.shape, np.nan, np.float32)
    _planes(cloud.points_mm, same.right, same.down, radius_px, out)
    return out


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _mark_connected(
    right: NDArray[np.bool_], down: NDArray[np.bool_], y: int, x: int, radius: int, reached: NDArray[np.bool_]
) -> None:
    """Mark the pixels of the window (2 radius + 1 squared) about (y, x) that paths without steps lead to."""
    h, w = down.shape[0] + 1, right.shape[1] + 1
    reached[:] = False
    reached[radius, radius] = True
    # Outwards, ring by ring of the city-block distance, so that the path to the previous pixel is known.
    for distance in range(1, 2 * radius + 1):
        for dy in range(-min(distance, radius), min(distance, radius) + 1):
            far = distance - abs(dy)
            if far > radius:
                continue
            for dx in (-far, far):
                v, u = y + dy, x + dx
                if v < 0 or v >= h or u < 0 or u >= w:
                    continue
                # From the neighbour one column nearer to the middle, or from that one row nearer.
                i, j = radius + dy, radius + dx
                across = (dx > 0 and reached[i, j - 1] and right[v, u - 1]) or (
                    dx < 0 and reached[i, j + 1] and right[v, u]
                )
                along = (dy > 0 and reached[i - 1, j] and down[v - 1, u]) or (
                    dy < 0 and reached[i + 1, j] and down[v, u]
                )
                reached[i, j] = across or along


@numba.njit(nogil=True, cache=True, error_model="numpy")
def _planes(
    points: NDArray[np.float32],
    right: NDArray[np.bool_],
    down: NDArray[np.bool_],
    radius: int,
    out: NDArray[np.float32],
) -> None:
    """Write the normal of every pixel whose plane is determined to ``out``.

    Symbols as at the module's head.
    """
    h, w = points.shape[0], points.shape[1]
    reached = np.zeros((2 * radius + 1, 2 * radius + 1), np.bool_)
    for y in range(h):
        for x in range(w):
            px, py, pz = float(points[y, x, 0]), float(points[y, x, 1]), float(points[y, x, 2])
            if not np.isfinite(pz):
                continue
            _mark_connected(right, down, y, x, radius, reached)
            # The frame of the ray: e lies in the plane of x and z, f = u × e.
            length = np.sqrt(px * px + py * py + pz * pz)
            ux, uy, uz = px / length, py / length, pz / length
            flat = np.sqrt(ux * ux + uz * uz)
            ex, ez = uz / flat, -ux / flat
            fx, fy, fz = uy * ez, uz * ex - ux * ez, -uy * ex
            n, sa, sb, sc, saa, sab, sbb, sac, sbc = 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for dy in range(-radius, radius + 1):
                for dx in range(-radius, radius + 1):
                    if not reached[radius + dy, radius + dx]:
                        continue
                    # Subtract before squaring: 500 mm and some hundredths would lose the hundredths.
                    qx, qy, qz = (
                        points[y + dy, x + dx, 0] - px,
                        points[y + dy, x + dx, 1] - py,
                        points[y + dy, x + dx, 2] - pz,
                    )
                    a, b, c = qx * ex + qz * ez, qx * fx + qy * fy + qz * fz, qx * ux + qy * uy + qz * uz
                    n += 1
                    sa, sb, sc = sa + a, sb + b, sc + c
                    saa, sab, sbb = saa + a * a, sab + a * b, sbb + b * b
                    sac, sbc = sac + a * c, sbc + b * c
            if n < LEAST_POINTS:
                continue
            # Normal equations about the mean: [aa ab; ab bb] (s t)ᵀ = (ac bc)ᵀ.
            aa, ab, bb = saa - sa * sa / n, sab - sa * sb / n, sbb - sb * sb / n
            ac, bc = sac - sa * sc / n, sbc - sb * sc / n
            determinant = aa * bb - ab * ab
            # At most ((aa + bb) / 2)², for points that spread equally in all directions; 0 for a line.
            if not determinant > LEAST_SPREAD * 0.25 * (aa + bb) ** 2:
                continue
            # Cramer's rule.
            s, t = (ac * bb - bc * ab) / determinant, (bc * aa - ac * ab) / determinant
            # (s, t, −1) of the ray's frame, of length 1 and back in the camera's.
            norm = 1.0 / np.sqrt(s * s + t * t + 1.0)
            out[y, x, 0] = (s * ex + t * fx - ux) * norm
            out[y, x, 1] = (t * fy - uy) * norm
            out[y, x, 2] = (s * ez + t * fz - uz) * norm
