"""Owns whether the two pictures of a pair show one board: the cameras' relative pose by each pair, against that by all others.

Each camera by itself tells where it sees the board in each picture. Two pictures of one moment give the cameras' relative pose; two of
different moments give something else each time. So the true pose is the one that most pairs agree on, and a sequence in which a
picture is missing agrees again where the pictures after it are paired one further on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.calibrate.air.linearised import BoardView
from appliance.measure import rotation_matrix

Array = NDArray[np.float64]
Place = tuple[Array, Array]
"""Rotation (3, 3) and translation (3,) in mm, board to camera."""

ELSEWHERE = 1 / 40
"""Distance in image widths between where a pair's cameras see the board from which on it is another moment's; poses of one camera
by itself agree to a tenth of that."""
MOST_SHIFT = 2
"""Pictures by which one camera's may be off the other's."""
LEAST_SHIFTED = 2
"""Pairs that must agree one further on before a picture is called missing."""
HALF = 0.5
"""Share of the pairs that must agree as they are named; where fewer do, pairs further on are asked for the pose."""
EXCHANGED = 0.3
"""A pair is exchanged if its pose is so near the inverse of the usual one, in units of the baseline."""


@dataclass(frozen=True, slots=True, eq=False)
class Pairing:
    """The cameras' pose by pairs that agree, and pairs that do not."""

    rotation: Array
    """(3, 3), of the right camera's frame in that of the left one."""
    shift_mm: Array
    """(3,)."""
    agreeing: int
    """Number of pairs that agree."""
    exchanged: frozenset[str]
    """Names of the pairs that show the pose the other way round."""
    elsewhere_px: Mapping[str, float]
    """Name of each other pair that disagrees, in order, and how far apart its two cameras see the board."""
    further_on: int
    """Number of pictures by which the right ones come later (positive) or earlier than their left ones from the first of
    ``elsewhere_px`` on; 0: it is not that."""


def pair_up(
    views: Sequence[BoardView], left: Mapping[str, Place], right: Mapping[str, Place], f_px: float, width_px: int
) -> Pairing:
    """Compare the relative poses of ``views``, in the order of their pictures: places by name, the right principal distance.

    Raises ValueError where no view has both places.
    """
    of_left = [k for k, view in enumerate(views) if view.name in left]
    seen = [_Seen.of(views, left, right, i, j) for i in of_left for j in _near(i, len(views)) if views[j].name in right]
    as_named = np.array([one.left == one.right for one in seen], np.bool_)
    if not as_named.any():
        raise ValueError("no view has both places")
    corners = np.stack([one.corners_mm for one in seen])
    there = _pinhole(np.stack([one.there_mm for one in seen]), f_px)
    # How far each pair is off, (n, n), if the cameras stood to each other as by another pair.
    off_px = np.stack([_rms(_pinhole((corners - one.shift_mm) @ one.rotation, f_px) - there) for one in seen])
    agrees = off_px < ELSEWHERE * width_px
    support = np.where(as_named, np.count_nonzero(agrees[:, as_named], axis=1), 0)
    if support.max() < HALF * np.count_nonzero(as_named):
        support = np.count_nonzero(agrees, axis=1)
    best = int(np.argmax(support))
    fellows = [one for one, agreed in zip(seen, agrees[best], strict=True) if agreed]
    R = rotation_matrix(np.median([np.ravel(cv2.Rodrigues(one.rotation)[0]) for one in fellows], axis=0))
    t = np.asarray(np.median([one.shift_mm for one in fellows], axis=0), np.float64)
    exchanged, elsewhere = [], {}
    for one, agreed, far_px in zip(seen, agrees[best], off_px[best], strict=True):
        name = views[one.left].name
        if one.left != one.right or agreed:
            continue
        if np.linalg.norm(one.shift_mm + R.T @ t) < EXCHANGED * np.linalg.norm(t):
            exchanged.append(name)
        else:
            elsewhere[name] = float(far_px)
    # Pictures from the first wrong pair on that no pair of their own explains, and a later or earlier one of the other camera does.
    fine = {one.left for one in fellows if one.left == one.right}
    first = min((k for k, view in enumerate(views) if view.name in elsewhere), default=len(views))
    steps = [
        one.right - one.left for one in fellows if one.left != one.right and one.left >= first and one.left not in fine
    ]
    further = max(set(steps), key=steps.count, default=0)
    enough = steps.count(further) >= max(LEAST_SHIFTED, HALF * (len(elsewhere) - MOST_SHIFT))
    agreeing = int(np.count_nonzero(agrees[best] & as_named))
    return Pairing(R, t, agreeing, frozenset(exchanged), elsewhere, further if enough else 0)


def _near(i: int, count: int) -> range:
    return range(max(0, i - MOST_SHIFT), min(count, i + MOST_SHIFT + 1))


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """A left and a right picture: four corners as each camera by itself places them, and the relative pose that follows."""

    left: int
    right: int
    rotation: Array
    shift_mm: Array
    corners_mm: Array
    """(4, 3), left camera's frame."""
    there_mm: Array
    """(4, 3), right camera's frame."""

    @classmethod
    def of(
        cls, views: Sequence[BoardView], left: Mapping[str, Place], right: Mapping[str, Place], i: int, j: int
    ) -> _Seen:
        (Rl, tl), (Rr, tr) = left[views[i].name], right[views[j].name]
        # Board → right → left must be board → left: R R_right = R_left, R t_right + t = t_left.
        R = Rl @ Rr.T
        few = _outermost(views[i].corners_mm)
        return cls(i, j, R, tl - R @ tr, few @ Rl.T + tl, few @ Rr.T + tr)


def _outermost(corners_mm: Array) -> Array:
    """Return the corners (4, 3) that reach farthest along both diagonals."""
    along = corners_mm[:, 0] + corners_mm[:, 1], corners_mm[:, 0] - corners_mm[:, 1]
    return corners_mm[[k for a in along for k in (int(a.argmin()), int(a.argmax()))]]


def _pinhole(points_mm: Array, f_px: float) -> Array:
    """Return pixels (…, 2) about the principal point; infinity behind the camera."""
    z = points_mm[..., 2:]
    ahead = np.where(z > 0.0, z, 1.0)
    return np.where(z > 0.0, f_px * points_mm[..., :2] / ahead, np.inf)


def _rms(off_px: Array) -> Array:
    """Return the root mean square distance of corners (n, 4, 2) as (n,); infinity for those behind a camera."""
    with np.errstate(invalid="ignore"):
        found = np.sqrt(np.mean(np.sum(off_px**2, axis=-1), axis=-1))
    return np.where(np.isfinite(found), found, np.inf)
