"""Owns how far something lies whose fringes are too faint to be decoded: at which depth both cameras see the same patterns.

A pixel must tell 5 grey values of fringes from noise before it is decoded; a small window over all images across the baseline
tells a seventh of that. So windows of the left camera are laid over the right one where each depth would put them, and their
changes from image to image compared. Of Gray images only what changes within the window counts: an edge is the object's, what
is smooth may be the water's.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.model import StereoRig
from appliance.measure.light.noise import CameraNoise, StereoNoise
from appliance.measure.light.sequence import Direction, PatternSequence

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

WIDTH_PX = 400
"""About so wide are the images made before they are compared: that costs little and averages noise away."""
ROWS, COLUMNS = 5, 14
"""Size of a window in such images: two fringes wide; a surface that slants by 20° shifts them by less than a third
at its ends."""
WINDOWS = 120
"""Those with the strongest fringes."""
LEAST_SWING_DN, LEAST_SHARE = 0.8, 0.1
"""Twice the amplitude of a window's fringes, at least, and as a share of what the projector's white adds there: less may be what is
left of long fringes in the illuminated water, which is near."""
CLEAR_DN = 250.0
"""No image of a window may be brighter anywhere; nor of any place where the right camera might see it, for what is saturated
there may be the window itself, and the likest of the other places is then a wrong fringe."""
_NEAREST_MM, _FARTHEST_MM = 250.0, 1500.0
"""Depths, of the standard housing, between which windows are looked for."""
STEP_PX = 1.5
"""Distance from depth to depth, as the right camera sees it: a fifth of a fringe."""
LEAST_LIKE = 0.25
"""Correlation from which on a window is found again; chance makes 0.1 over all depths at most, fringes of 0.7 grey values 0.4."""
BESIDE, DISTINCT = 3, 1.1
"""And by so much more than at any depth that is farther away than these steps: fringes repeat, Gray edges do not."""
MIN_WINDOWS = 12


def find_depths_mm(
    frames: Mapping[str, NDArray[np.uint8]],
    sequence: PatternSequence,
    noise: StereoNoise,
    rig: StereoRig,
    water_index: float,
) -> Array:
    """Return the depth of each window that is found again, in the left camera's frame; to half a per cent. Empty
    where fewer than ``MIN_WINDOWS`` are. ``frames``: (n, h, w) uint8 of ``left`` and ``right``."""
    none = np.empty(0)
    factor = max(1, rig.left.width_px // WIDTH_PX)
    left = _changes(frames["left"], sequence, factor)
    right = _changes(frames["right"], sequence, factor)
    v, u = _strongest(frames["left"], sequence, factor, left, noise.left)
    if len(v) < MIN_WINDOWS:
        return none
    depths_mm = candidate_depths_mm(rig, water_index)
    # What scales with an image is the place from its edge on, half a pixel before the first one's middle.
    half = 0.5 * np.array([COLUMNS, ROWS])
    seen = seen_at_depths(rig, water_index, factor * (np.stack([u, v], -1) + half) - 0.5, depths_mm)
    places = (seen + 0.5) / factor - half
    like = np.stack([
        _likeness(left, right, (int(v[k]), int(u[k])), places[k]) for k in range(len(v))
    ])  # fmt: skip
    best = like.argmax(axis=1)
    beside = abs(np.arange(len(depths_mm)) - best[:, None]) > BESIDE
    sure = like.max(axis=1) >= np.maximum(LEAST_LIKE, DISTINCT * np.where(beside, like, 0.0).max(axis=1))
    sure &= _clear_everywhere(_brightest(frames["right"], sequence, factor), places)
    found = depths_mm[best[sure]]
    return found if len(found) >= MIN_WINDOWS else none


def _changes(frames: NDArray[np.uint8], sequence: PatternSequence, factor: int) -> Floats:
    """Return (channels, rows, columns) opposite sines' differences, then each Gray image against half way from dark
    to bright."""
    axis = sequence.axis(Direction.X)
    small = {k: _shrunk(frames[k], factor) for k in (sequence.bright, sequence.dark, *axis.sine, *axis.gray)}
    i0, i1, i2, i3 = (small[k] for k in axis.sine)
    both = small[sequence.bright] + small[sequence.dark]
    return np.stack([i0 - i2, i3 - i1, *(2.0 * small[k] - both for k in axis.gray)]).astype(np.float32)


def _shrunk(image: NDArray[np.uint8], factor: int) -> Floats:
    if factor == 1:
        return image.astype(np.float32)
    rows, columns = image.shape[0] // factor, image.shape[1] // factor
    boxes = image[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor)
    return np.asarray(boxes.mean(axis=(1, 3), dtype=np.float32))


def _strongest(
    frames: NDArray[np.uint8], sequence: PatternSequence, factor: int, changes: Floats, noise: CameraNoise
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the upper left corners (rows, columns) of the windows that show most fringes beyond noise and are
    nowhere saturated."""
    sines = sequence.axis(Direction.X).sine
    level = np.mean([_shrunk(frames[k], factor) for k in sines], axis=0)
    chance = 4.0 * noise.variance_dn2(level) / factor**2
    excess = _tiled(changes[0] ** 2 + changes[1] ** 2 - chance).mean(axis=(1, 3))
    clear = _tiled(_brightest(frames, sequence, factor)).max(axis=(1, 3)) < CLEAR_DN
    light = _tiled(_shrunk(frames[sequence.bright], factor) - _shrunk(frames[sequence.dark], factor)).mean(axis=(1, 3))
    excess[~clear | (excess < np.maximum(LEAST_SWING_DN, LEAST_SHARE * light) ** 2)] = 0.0
    order = np.argsort(-excess, axis=None)[:WINDOWS]
    rows, columns = np.unravel_index(order[excess.ravel()[order] > 0.0], excess.shape)
    return rows * ROWS, columns * COLUMNS


def _brightest(frames: NDArray[np.uint8], sequence: PatternSequence, factor: int) -> Floats:
    """Return a small image of the brightest grey value that each pixel has in the bright image and the sines."""
    bright = (sequence.bright, *sequence.axis(Direction.X).sine)
    return _shrunk(np.maximum.reduce([frames[k] for k in bright]), factor)


def _clear_everywhere(brightest: Floats, places: Array) -> NDArray[np.bool_]:
    """Return (n,) whether nothing is too bright in any of the windows at ``places`` (n, depths, 2: column, row)
    within the image."""
    clear = np.asarray((_windows(brightest) < CLEAR_DN).all(axis=(2, 3)))
    at, inside = _within(places, clear.shape)
    return np.asarray((clear[at[..., 1], at[..., 0]] | ~inside).all(axis=1), np.bool_)


def _windows(images: Floats) -> Floats:
    """Return (…, rows, columns, ROWS, COLUMNS): the window at each corner, without a copy."""
    return np.lib.stride_tricks.sliding_window_view(images, (ROWS, COLUMNS), axis=(-2, -1))


def _within(places: Array, corners: tuple[int, ...]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return ``places`` as whole numbers, and which of them are among so many ``corners`` (rows, columns); 0 for the others."""
    at = np.rint(places)
    inside = np.asarray(((at >= 0.0) & (at < corners[::-1])).all(axis=-1))
    return np.where(inside[..., None], at, 0.0).astype(np.int64), inside


def _tiled(image: Floats) -> Floats:
    rows, columns = image.shape[0] // ROWS, image.shape[1] // COLUMNS
    return np.asarray(image[: rows * ROWS, : columns * COLUMNS].reshape(rows, ROWS, columns, COLUMNS))


def candidate_depths_mm(rig: StereoRig, water_index: float) -> Array:
    """Return depths so close to each other that the right camera sees the image's middle move by ``STEP_PX`` of a
    small image's."""
    nearest_mm, farthest_mm = rig.volume.scaled(_NEAREST_MM), rig.volume.scaled(_FARTHEST_MM)
    near, far = 1.0 / nearest_mm, 1.0 / farthest_mm
    middle = np.array([[0.5 * (rig.left.width_px - 1), 0.5 * (rig.left.height_px - 1)]])
    ends = seen_at_depths(rig, water_index, middle, np.array([nearest_mm, farthest_mm]))[0, :, 0]
    count = int(abs(ends[1] - ends[0]) * WIDTH_PX / rig.left.width_px / STEP_PX) + 2
    return np.asarray(1.0 / np.linspace(near, far, count))


def seen_at_depths(rig: StereoRig, water_index: float, uv_px: Array, depths_mm: Array) -> Array:
    """Return (n, depths, 2) where the right camera sees what the left one sees at ``uv_px`` (n, 2), were it at each
    depth."""
    origins, directions = rig.left.rays(uv_px, water_index)
    far = (depths_mm[None, :] - origins[:, None, 2]) / directions[:, None, 2]
    return rig.right.project(origins[:, None, :] + far[..., None] * directions[:, None, :], water_index)


def _likeness(left: Floats, right: Floats, corner: tuple[int, int], places: Array) -> Floats:
    """Return the correlation of the left window with the right ones at ``places`` (depths, 2: column, row); 0
    outside of the image."""
    v, u = corner
    mine = _own(left[None, :, v : v + ROWS, u : u + COLUMNS])[0]
    windows = _windows(right)
    at, inside = _within(places, windows.shape[1:3])
    theirs = _own(windows[:, at[inside, 1], at[inside, 0]].swapaxes(0, 1))
    like = np.zeros(len(places), np.float32)
    power = np.sqrt(np.einsum("dcij,dcij->d", theirs, theirs) * float(np.sum(mine * mine)))
    like[inside] = np.einsum("dcij,cij->d", theirs, mine) / np.maximum(power, np.float32(1e-6))
    return like


def _own(windows: Floats) -> Floats:
    """Return ``windows`` (n, channels, rows, columns) without what the Gray images do not change within them."""
    gray = windows[:, 2:]
    return np.concatenate([windows[:, :2], gray - gray.mean(axis=(2, 3), keepdims=True)], axis=1)
