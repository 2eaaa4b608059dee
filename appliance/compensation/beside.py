"""Owns how far points are followed within four sines, and what is needed to read beside their way: smooth depth and paint.

A point that moves along with the fringes sees nearly one phase in all four steps: followed all the way, its noise grows
without limit. At its pixel fringes step by 90° as ever, only that another part of the surface is there. So the way is
followed in part: each sine is read where the fringes have stepped on enough, as far beside the point as that takes; by how
much the surface there lies elsewhere comes from its smooth depth, by how much its paint is brighter from the Gray images.
The steps are made alike in both cameras: what the fringes' harmonics do to a coordinate stays alike in both.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.compensation.grays import Stripes, stripes_of
from appliance.compensation.paint import evened, gather, known_smooth
from appliance.compensation.solve import FIRST_GRAY, Sources, Terms, depth_rows
from appliance.compensation.ways import FIRST_WAY, PER_FRAME, Ways
from appliance.patterns.sequence import Direction, PatternSequence

Picture = NDArray[np.float32]

SHARES = (1.0, 0.75, 0.5, 0.25)
GOOD_VARIANCE = 1.5
"""Of a phase, of that by steps of 90°: less is not worth what reading beside the way brings in."""
NEAR_IMAGES = 4
"""Of the Gray images before the x-sines and after them are asked for paint: the farther, the less their place is known."""
SMOOTH_PX, EVEN_PX, NEAR_PX, VEIL_PX = 11, 5, 15, 31
"""Windows in px of pictures 800 px wide; ``SMOOTH_PX`` of depth is 7 mm."""
FILLED_SD = 0.03
"""Of the paint, as a share, where only its neighbours' is known."""
PLACE_PX = 0.2
"""By so much, in px of pictures 800 px wide, paint may lie elsewhere than the motion says."""
LOOKED_UP = 0.7
"""Variance of a value read between pixels, in the mean."""


def choose_shares(way: Ways) -> tuple[float, float]:
    """Shares of points' ways that are followed within the x-sines and within the y-sines: the largest that is good enough."""
    x, y = (_choose(way, block) for block in (0, 1))
    return x, y


def _choose(way: Ways, block: int) -> float:
    known = [phase_variance(way, block, share) for share in SHARES]
    good = [share for share, variance in zip(SHARES, known, strict=True) if variance <= GOOD_VARIANCE]
    return good[0] if good else SHARES[int(np.argmin(known))]


def phase_variance(way: Ways, block: int, share: float) -> float:
    """Of the block's phases where ``share`` of a point's way is followed, of that by steps of 90°; in the middle of the
    volume, median over the image, mean over all phases."""
    first = FIRST_WAY + 4 * PER_FRAME * block + 6
    moved = way.nodes[..., first : first + 4 * PER_FRAME : PER_FRAME].astype(np.float64)
    steps = 2.0 * np.pi * (share * moved + 0.25 * np.arange(4))
    A = np.stack([np.ones_like(steps), np.cos(steps), -np.sin(steps)], -1)
    normal = np.einsum("...ki,...kj->...ij", A, A) + 1e-9 * np.eye(3)
    inverse = np.linalg.inv(normal)
    return float(np.median(inverse[..., 1, 1] + inverse[..., 2, 2]))


def with_depth(sources: Sources, terms: Terms, way: Ways) -> Sources:
    """``sources`` with the smooth depth that its columns tell."""
    height, width = sources.p_px.shape
    depth = np.empty((height, width), np.float32)
    depth_rows(sources.p_px, way, terms.fill_px, 0, height, depth)
    depth[~np.isfinite(sources.p_px)] = np.nan
    window_px = _window(SMOOTH_PX, width)
    smooth = known_smooth(known_smooth(depth, window_px), window_px)
    by_row, by_column = (np.asarray(one, np.float32) for one in np.gradient(smooth))
    return sources._replace(depth=smooth, by_column=by_column, by_row=by_row)


def with_paint(sequence: PatternSequence, sources: Sources, terms: Terms, way: Ways) -> Sources:
    """``sources`` with the paint of what is at its columns' depth."""
    height, width = sources.p_px.shape
    depth = np.empty((height, width), np.float32)
    depth_rows(sources.p_px, way, terms.fill_px, 0, height, depth)
    lit, lit_count, dark, dark_count = (np.empty((height, width), np.float32) for _ in range(4))
    stripes, places = near_stripes(sequence)
    gather(sources.frames, stripes, places, way, depth, terms.period_px, 0, height, lit, lit_count, dark, dark_count)
    veil = np.nan_to_num(known_smooth(dark, _window(VEIL_PX, width)))
    del depth, dark, dark_count  # 8 MB each at full size
    full_dn2 = terms.dark_dn2 + terms.shot_dn * np.maximum(lit, np.float32(0.0))
    noise_dn2 = np.asarray(LOOKED_UP * full_dn2 / np.maximum(lit_count, 1.0), np.float32)
    even_px = _window(EVEN_PX, width)
    del full_dn2, lit_count
    grey, variance = evened(lit - veil, noise_dn2, even_px)
    del lit, noise_dn2
    near = known_smooth(known_smooth(grey, even_px), _window(NEAR_PX, width))
    unseen = ~np.isfinite(grey)
    grey = np.where(unseen, near, grey)
    variance = np.where(unseen, np.float32(FILLED_SD**2) * near**2, variance)
    uneven = sum(np.asarray(one, np.float32) ** 2 for one in np.gradient(grey))
    misplaced = np.nan_to_num(np.float32((PLACE_PX * width / 800.0) ** 2) * uneven)
    doubt = np.asarray((variance + misplaced) / np.maximum(grey, np.float32(1.0)) ** 2, np.float32)
    return sources._replace(paint=grey, veil=veil, doubt=doubt)


def _window(px: int, width: int) -> int:
    """In this picture's px; odd."""
    return 2 * round(0.5 * px * width / 800.0) + 1


def near_stripes(sequence: PatternSequence) -> tuple[Stripes, NDArray[np.int64]]:
    """The Gray images that are asked for paint, and their places among what is followed."""
    every = stripes_of(sequence, 0.0)
    x = sequence.axis(Direction.X)
    chosen = np.flatnonzero((every.frames >= x.sine[0] - NEAR_IMAGES) & (every.frames <= x.sine[-1] + NEAR_IMAGES))
    near = Stripes(every.frames[chosen], every.axes[chosen], every.widths_px[chosen])
    return near, FIRST_GRAY + chosen
