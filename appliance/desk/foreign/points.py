"""Owns the way from decoded foreign images to points: two directions by the instrument's own kernels, one along epipolar curves; and of
each left pixel without a point the reason.

A projector that was calibrated takes the right camera's place: its "image" has, at each pixel, the coordinates of that pixel.

Symbols: the pattern's coordinates are scaled so that one camera pixel sees about as much of the pattern as on the instrument, for
which the search for neighbours was made; no point depends on their scale.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.desk.foreign.camera import CleanAxis, CleanCamera
from appliance.desk.foreign.cameras import ForeignRig
from appliance.desk.foreign.description import Description
from appliance.desk.foreign.phase import Floats
from appliance.desk.foreign.reasons import BEFORE_POINTS, GAP_PIXELS, REASONS, SIGMA_PIXELS, Reason
from appliance.measure import (
    TYPICAL_PAIR,
    UNCHECKED,
    CurveError,
    FoldingLens,
    HousedCamera,
    LeftMaps,
    OneDirectionError,
    OneDirectionLimits,
    OrganisedCloud,
    PointLimits,
    PointTable,
    StereoRig,
    fill_inverse_map,
    match_along_curves,
    ray_lattice,
    rays_of,
    reconstruct_rows,
    right_maps,
    scratch_rows,
    sigma_factors,
    usual_step_px,
)

USUAL_STEP_PX = 0.63
"""Change of a coordinate from one pixel to the next on the instrument, for images 1600 px wide."""
STEP_PIXELS, STEP_SIGMAS = 9.4, 3.0
"""Allowed step in depth to a neighbour, over the size of a pixel on the object there, and over the expected error."""
LEAST_NEIGHBOURS = 5
NEAR_OF_CROSSING, FAR_OF_CROSSING = 0.3, 4.0
LEAST_CROSSING = 0.2
"""Depth of the crossing over the baseline, below which the cameras look past each other: axes at 79°."""
NEAR_BASELINES, FAR_BASELINES = 1.0, 60.0
"""Depths that are searched where nothing is said: about where the cameras' axes cross, or from so many baselines to so many."""
NARROWER = (1.0, 0.6, 0.35)
"""Shares of that range (of its logarithm, about its middle) that are searched one after the other, until curves can follow it."""
ROWS = 256
"""Left rows that are judged together: what is compared needs room."""
STRIP_PX = 512
"""Left columns that are reconstructed together: fewer than a scratch row has room for (``scratch.MAX_WIDTH_PX``), and copies that need little."""
MOST_PX = 65_535
"""Widest and highest image that two directions can be looked up in: its pixels' numbers are packed into 16 bits each."""
_ALL = PointLimits(*np.array([np.inf, np.inf, -np.inf, np.inf, np.inf, 0.0], np.float32))
"""Limits that every point keeps: which one it breaks is told afterwards."""


@dataclass(frozen=True, slots=True, eq=False)
class ForeignCloud:
    """The points of a foreign set on the left image's pixels."""

    cloud: OrganisedCloud
    unchecked: str | None
    """Warning about points that nothing has checked; ``None``: the rays' gaps have."""
    depths_mm: tuple[float, float]
    """Depths that were searched."""
    lit: int
    """Number of left pixels with coordinates, but for edges."""
    reason_map: NDArray[np.uint8]
    """(h, w), values of ``Reason``."""
    over_sigma_mm: float
    """Median of the expected errors that were too large; NaN where none was."""
    failure: str | None
    """Why nothing could be searched at all; ``None``: it was."""

    @property
    def points(self) -> int:
        """Number of points."""
        return int(np.count_nonzero(self.cloud.mask))

    @property
    def reasons(self) -> dict[str, int]:
        """Number of left pixels without a point by reason, a word of ``REASONS``; the most frequent first."""
        # Map by map: to count all at once makes eight bytes of each pixel's one.
        counts = {one: int(np.count_nonzero(self.reason_map == one)) for one in Reason if one}
        return {one.word: counts[one] for one in sorted(counts, key=lambda k: -counts[k]) if counts[one]}

    def largest_reasons(self, *, of_lit: bool = False) -> list[str]:
        """Return the two reasons why most left pixels, or most of those ``of_lit`` with coordinates, have no point, as a line each."""
        counts = {word: count for word, count in self.reasons.items() if not (of_lit and word in BEFORE_POINTS)}
        pixels = self.points + sum(counts.values())
        lines = []
        for word, count in counts.items():
            more = f", mostly {self.over_sigma_mm:.3g} mm" if word == "sigma" else ""
            lines.append(f"{word}: {100.0 * count / pixels:.1f} %{more} ({REASONS[word]})")
        return lines[:2]


def depths_of(description: Description, rig: StereoRig, index: float) -> tuple[float, float]:
    """Return nearest and farthest depth in mm to be searched: what the description says, else what the cameras look at."""
    baseline_mm = math.hypot(*rig.right.translation_mm)
    try:
        crossing_mm = float(rig.volume_centre_mm(index)[2])
    except ValueError:
        crossing_mm = math.inf
    if LEAST_CROSSING * baseline_mm < crossing_mm < FAR_BASELINES * baseline_mm:
        near_mm, far_mm = NEAR_OF_CROSSING * crossing_mm, FAR_OF_CROSSING * crossing_mm
    else:
        near_mm, far_mm = NEAR_BASELINES * baseline_mm, FAR_BASELINES * baseline_mm
    # Rays begin at the window's outer face.
    port = rig.left.port
    window_mm = 0.0 if rig.left.lens_in_water else 1.05 * (port.distance_mm + port.thickness_mm + 1.0)
    return description.near_mm or max(near_mm, window_mm), description.far_mm or max(far_mm, 2.0 * window_mm)


def find_points(
    description: Description, rig: ForeignRig, left: CleanCamera, right: CleanCamera | None
) -> ForeignCloud:
    """Find the points of the left pixels; without ``right``, the rig's right camera is a projector.

    Nothing is raised: where there are no points, ``reasons`` and ``failure`` say why.
    """
    lenient = replace(rig.rig, left=_lenient(rig.rig.left), right=_lenient(rig.rig.right))
    reason = left.reason.copy()
    known = reason == Reason.FOUND
    lit = int(np.count_nonzero(known))
    reason[known & _without_ray(lenient.left, rig.index)] = Reason.NO_RAY
    known &= reason == Reason.FOUND
    reason[known] = Reason.NO_MATCH
    depths_mm = depths_of(description, lenient, rig.index)
    if right is None:
        other = {name: CleanAxis(one, np.zeros_like(one), 1.0) for name, one in own_px(lenient.right).items()}
    else:
        other = dict(right.axes)
    failure: str | None = None
    cloud: OrganisedCloud | None = None
    if not known.any():
        failure = "no pixel of the left camera has coordinates and a ray"
    elif description.one_direction:
        name = description.axes[0].name
        ends = (description.near_mm, description.far_mm)
        for share in NARROWER[: 1 if None not in ends else None]:
            depths_mm = _narrowed(depths_of(description, lenient, rig.index), share)
            try:
                cloud = _one_direction(lenient, rig.index, left, other[name], depths_mm)
            except (OneDirectionError, CurveError) as error:
                failure = str(error)
                continue
            failure = None
            break
    elif right is not None and not (right.reason == Reason.FOUND).any():
        failure = "no pixel of the right camera has both coordinates"
    else:
        cloud = _two_directions(lenient, rig.index, left, other, depths_mm)
    cloud = _nothing(left) if cloud is None else cloud
    over_sigma_mm = _judge(cloud, reason, depths_mm, lenient.left.lens.f_px[0], description.max_sigma_mm)
    return ForeignCloud(
        cloud, UNCHECKED if description.one_direction else None, depths_mm, lit, reason, over_sigma_mm, failure
    )


def _nothing(left: CleanCamera) -> OrganisedCloud:
    """Return a cloud to be filled in."""
    points, *others = (np.full((*left.grey.shape, *more), np.nan, np.float32) for more in ((3,), (), (), ()))
    return OrganisedCloud(points, others[0], others[1], others[2], left.grey)


def _one_direction(
    rig: StereoRig, index: float, left: CleanCamera, other: CleanAxis, depths_mm: tuple[float, float]
) -> OrganisedCloud:
    """Return the points along epipolar curves. Raises OneDirectionError, CurveError."""
    (mine,) = left.axes.values()
    found = match_along_curves(
        mine.coordinate_px, other.coordinate_px, rig, index, depths_mm, (mine.sigma_px, other.sigma_px), OneDirectionLimits(min_neighbours=0),
        partners=False,
    )  # fmt: skip
    # A copy: what breaks a limit is taken out of the cloud.
    return OrganisedCloud(
        found.points_mm, found.sigma_mm, left.modulation_dn.copy(), np.full_like(found.sigma_mm, np.nan), left.grey
    )


def _two_directions(
    rig: StereoRig, index: float, left: CleanCamera, other: Mapping[str, CleanAxis], depths_mm: tuple[float, float]
) -> OrganisedCloud:
    """Return the points where rays meet."""
    low_px, size_px = [], []
    for name in "xy":
        both = [one[name].coordinate_px for one in (left.axes, other)]
        low_px.append(min(float(np.nanmin(one)) for one in both))
        size_px.append(max(float(np.nanmax(one)) for one in both) - low_px[-1])
    # So large is the pattern that one pixel sees as much of it as on the instrument, and no larger than its map has room for.
    scale = min(
        USUAL_STEP_PX * 1600.0 / rig.right.width_px / max(other["x"].step_px, other["y"].step_px),
        4.0 * math.sqrt(rig.right.width_px * rig.right.height_px / (size_px[0] * size_px[1] + 1.0)),
    )
    p2, q2, variance2 = _scaled(other, low_px, scale)
    seen = np.full(p2.shape, np.uint8(255))
    maps = right_maps(p2, q2, seen, int(scale * size_px[0]) + 2, int(scale * size_px[1]) + 2, variance2)
    fill_inverse_map(maps, 1)
    plane_mm = math.sqrt(depths_mm[0] * depths_mm[1])
    # The series of a ray needs three rows of nodes.
    step_px = min(min(usual_step_px(camera), camera.height_px - 1) for camera in (rig.left, rig.right))
    first_rays, second_rays = (
        ray_lattice(one, index, plane_mm, step_px, partial=True) for one in (rig.left, rig.right)
    )
    rays = rays_of(first_rays, second_rays, rig.left.width_px)
    cloud = _nothing(left)
    height = left.grey.shape[0]
    table, scratch = PointTable(height * (STRIP_PX + 2)), scratch_rows()
    factors = sigma_factors(16, TYPICAL_PAIR)  # for its footprints alone: noise is the maps' own
    for first in range(0, left.grey.shape[1], STRIP_PX):
        # With one more on either side: the noise of a pixel is told with its neighbours.
        begin = max(first - 1, 0)
        columns = np.s_[..., begin : first + STRIP_PX + 1]
        grey = np.ascontiguousarray(left.grey[columns])
        half = np.clip(np.rint(2.0 * left.modulation_dn[columns]), 0.0, 255.0).astype(np.uint8)
        own = rays._replace(left=np.ascontiguousarray(rays.left[columns]))
        p, q, variance = _scaled(left.axes, low_px, scale, columns)
        lit = np.tile(np.array([0, p.shape[1]], np.int32), (height, 1))
        strip = LeftMaps(p, q, half, grey, grey, lit, np.float32(1.0), variance)
        count = int(reconstruct_rows(strip, maps, own, _ALL, factors, 0, height, 1, scratch, table.points, 0))
        found = table.points
        # Flat in the strip, and in all rows and columns of the image.
        row, column = np.divmod(found.pixel[:count], p.shape[1])
        inner = np.flatnonzero((column + begin >= first) & (column + begin < first + STRIP_PX))
        at = row[inner], column[inner] + begin
        cloud.points_mm[at], cloud.sigma_mm[at] = found.xyz_mm[inner], found.sigma_mm[inner]
        cloud.ray_gap_mm[at] = found.gap_mm[inner]
        cloud.modulation_dn[at] = np.float32(0.5) * found.modulation_half_dn[inner]
    return cloud


def _judge(
    cloud: OrganisedCloud,
    reason: NDArray[np.uint8],
    depths_mm: tuple[float, float],
    f_px: float,
    max_sigma_mm: float | None,
) -> float:
    """Say of each point which limit it breaks, and take out those that break one; return the median of the expected errors that were too large."""
    over_mm = [np.zeros(0, np.float32)]
    height, width = reason.shape
    z_mm = np.pad(cloud.points_mm[..., 2], 1, constant_values=np.nan)
    for start in range(0, height, ROWS):
        rows = np.s_[start : min(start + ROWS, height)]
        z = z_mm[1:-1, 1:-1][rows]
        # Size of a pixel on the object there.
        pixel_mm = np.abs(z) / np.float32(f_px)
        # A slope, not an error: between pixels farther apart there is more of it. Noise adds to it.
        most_step_mm = np.fmax(np.float32(STEP_PIXELS) * pixel_mm, np.float32(STEP_SIGMAS) * cloud.sigma_mm[rows])
        near = np.zeros(z.shape, np.uint8)
        for j, i in ((0, 0), (0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1), (2, 2)):
            around = z_mm[j : j + height, i : i + width][rows]
            near += np.abs(around - z) <= most_step_mm
        most_sigma_mm = SIGMA_PIXELS * pixel_mm if max_sigma_mm is None else max_sigma_mm
        broken = {
            Reason.NEIGHBOURS: near < LEAST_NEIGHBOURS,
            Reason.DEPTH: (z < depths_mm[0]) | (z > depths_mm[1]),
            Reason.SIGMA: cloud.sigma_mm[rows] > most_sigma_mm,
            Reason.GAP: cloud.ray_gap_mm[rows] > GAP_PIXELS * pixel_mm,
        }
        # A point that breaks several keeps the last one written: what passes each other is nowhere, whatever its depth.
        here = np.where(np.isfinite(z), np.uint8(Reason.FOUND), reason[rows])
        for why, breaks in broken.items():
            here[np.isfinite(z) & breaks] = why
        reason[rows] = here
        over_mm.append(cloud.sigma_mm[rows][here == Reason.SIGMA])
        for values in (cloud.points_mm, cloud.sigma_mm, cloud.ray_gap_mm, cloud.modulation_dn):
            values[rows][here != Reason.FOUND] = np.nan
    over = np.concatenate(over_mm)
    return float(np.median(over)) if over.size else math.nan


def _without_ray(camera: HousedCamera, index: float) -> NDArray[np.bool_]:
    """Tell (h, w) which pixels have no ray, as those have none about which the lattice has none."""
    lattice = ray_lattice(camera, index, 0.0, partial=True)
    lost = np.isnan(lattice.nodes[..., 2])
    cells = lost[1:, 1:] | lost[1:, :-1] | lost[:-1, 1:] | lost[:-1, :-1]
    return cells.repeat(lattice.step_px, 0).repeat(lattice.step_px, 1)[: camera.height_px, : camera.width_px]


def _scaled(
    maps: Mapping[str, CleanAxis], low_px: list[float], scale: float, part: Any = ...
) -> tuple[Floats, Floats, Floats]:
    """Return a part of both coordinates from the lowest on, NaN where one is missing, and the mean of their variances, in scaled px."""
    both = [maps[name] for name in "xy"]
    p, q = (
        (one.coordinate_px[part] - np.float32(low)) * np.float32(scale) for one, low in zip(both, low_px, strict=True)
    )
    missing = np.isnan(p) | np.isnan(q)
    p[missing], q[missing] = np.nan, np.nan
    spread = np.hypot(*(one.sigma_px[part] for one in both))
    return p, q, np.square(spread, out=spread) * np.float32(0.5 * scale**2)


def _lenient(camera: HousedCamera) -> HousedCamera:
    """Return the camera with a lens that has no rays where its distortion folds over: nobody asks others to calibrate again."""
    lens = camera.lens
    return replace(camera, lens=FoldingLens(lens.f_px, lens.c_px, lens.distortion))


def _narrowed(depths_mm: tuple[float, float], share: float) -> tuple[float, float]:
    """Return a part of the range about its middle."""
    middle_mm = math.sqrt(depths_mm[0] * depths_mm[1])
    return middle_mm * (depths_mm[0] / middle_mm) ** share, middle_mm * (depths_mm[1] / middle_mm) ** share


def own_px(projector: HousedCamera) -> dict[str, Floats]:
    """Return what a projector "sees": the coordinates of each of its pixels."""
    v, u = np.mgrid[0 : projector.height_px, 0 : projector.width_px].astype(np.float32)
    return {"x": u, "y": v}
