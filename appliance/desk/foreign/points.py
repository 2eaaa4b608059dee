"""Owns the way from decoded foreign images to points: two directions by the instrument's own kernels, one along
epipolar curves; and of each left pixel without a point the reason.

A projector that was calibrated takes the right camera's place: its "image" has, at each pixel, the coordinates of that
pixel.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.desk.foreign.assumptions import ExaminedAssumption, Outcome
from appliance.desk.foreign.camera import CleanCamera
from appliance.desk.foreign.cameras import ForeignRig
from appliance.desk.foreign.decode import GAP_PIXELS, SIGMA_PIXELS, Reason
from appliance.desk.foreign.description import Description
from appliance.desk.foreign.phase import Floats
from appliance.measure import (
    UNCHECKED,
    CoordinateMap,
    CurveError,
    FoldingLens,
    HousedCamera,
    OneDirectionLimits,
    OrganisedCloud,
    StereoRig,
    match_along_curves,
    no_points,
    pixels_without_ray,
    points_of_maps,
)

STEP_PIXELS, STEP_SIGMAS = 9.4, 3.0
"""Allowed step in depth to a neighbour, over the size of a pixel on the object there, and over the expected error."""
LEAST_NEIGHBOURS = 5
NEAR_OF_CROSSING, FAR_OF_CROSSING = 0.3, 4.0
LEAST_CROSSING = 0.2
"""Depth of the crossing over the baseline, below which the cameras look past each other: axes at 79°."""
NEAR_BASELINES, FAR_BASELINES = 1.0, 60.0
"""Depths that are searched where nothing is said: about where the cameras' axes cross, or from so many baselines to so
many."""
NARROWER = (1.0, 0.6, 0.35)
"""Shares of that range (of its logarithm, about its middle) that are searched one after the other, until curves can
follow it."""
ROWS = 256
"""Left rows that are judged together: what is compared needs room."""


@dataclass(frozen=True, slots=True, eq=False)
class ForeignScan:
    """A foreign set that was read and decoded, and what its images say of its description."""

    description: Description
    rig: ForeignRig
    cameras: Mapping[str, CleanCamera]
    """``left`` and, unless a projector takes its place, ``right``."""
    tested: tuple[ExaminedAssumption, ...]

    @property
    def wrong(self) -> tuple[ExaminedAssumption, ...]:
        """Assumptions that the images contradict."""
        return tuple(one for one in self.tested if one.outcome is Outcome.WRONG)


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
    def reasons(self) -> dict[Reason, int]:
        """Number of left pixels without a point by reason; the most frequent first."""
        # Map by map: to count all at once makes eight bytes of each pixel's one.
        counts = {one: int(np.count_nonzero(self.reason_map == one)) for one in Reason if one}
        return {one: counts[one] for one in sorted(counts, key=lambda k: -counts[k]) if counts[one]}

    def largest_reasons(self, *, of_lit: bool = False) -> list[str]:
        """Return the two reasons why most left pixels, or most of those ``of_lit`` with coordinates, have no point, as
        a line each."""
        counts = {one: count for one, count in self.reasons.items() if not (of_lit and one < Reason.NO_RAY)}
        pixels = self.points + sum(counts.values())
        lines = []
        for one, count in counts.items():
            more = f", mostly {self.over_sigma_mm:.3g} mm" if one is Reason.SIGMA else ""
            lines.append(f"{one.word}: {100.0 * count / pixels:.1f} %{more} ({one.text})")
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
    reason[known & pixels_without_ray(lenient.left, rig.index)] = Reason.NO_RAY
    known &= reason == Reason.FOUND
    reason[known] = Reason.NO_MATCH
    depths_mm = depths_of(description, lenient, rig.index)
    if right is None:
        other = {name: CoordinateMap(one, np.zeros_like(one), 1.0) for name, one in own_px(lenient.right).items()}
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
            except CurveError as error:
                failure = str(error)
                continue
            failure = None
            break
    elif right is not None and not (right.reason == Reason.FOUND).any():
        failure = "no pixel of the right camera has both coordinates"
    else:
        cloud = points_of_maps(lenient, rig.index, left.axes, other, left.grey, left.modulation_dn, depths_mm)
    cloud = no_points(left.grey) if cloud is None else cloud
    over_sigma_mm = _judge(cloud, reason, depths_mm, lenient.left.lens.f_px[0], description.max_sigma_mm)
    return ForeignCloud(
        cloud, UNCHECKED if description.one_direction else None, depths_mm, lit, reason, over_sigma_mm, failure
    )


def _one_direction(
    rig: StereoRig, index: float, left: CleanCamera, other: CoordinateMap, depths_mm: tuple[float, float]
) -> OrganisedCloud:
    """Return the points along epipolar curves. Raises CurveError."""
    (mine,) = left.axes.values()
    found = match_along_curves(
        mine.coordinate_px,
        other.coordinate_px,
        rig,
        index,
        depths_mm,
        (mine.sigma_px, other.sigma_px),
        OneDirectionLimits(min_neighbours=0),
        partners=False,
    )
    # A copy: what breaks a limit is taken out of the cloud.
    return OrganisedCloud(
        found.points_mm, found.sigma_mm, left.modulation_dn.copy(), np.full_like(found.sigma_mm, np.nan), left.grey
    )


def _judge(
    cloud: OrganisedCloud,
    reason: NDArray[np.uint8],
    depths_mm: tuple[float, float],
    f_px: float,
    max_sigma_mm: float | None,
) -> float:
    """Say of each point which limit it breaks, and take out those that break one; return the median of the expected
    errors that were too large."""
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


def _lenient(camera: HousedCamera) -> HousedCamera:
    """Return the camera with a lens that has no rays where its distortion folds over: nobody asks others to calibrate
    again."""
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
