"""Points from decoded foreign images, and the mask reason of each left pixel without a point.

Two directions use the instrument's own kernels, a single direction epipolar matching. A calibrated projector takes the
place of the right camera: its "image" has, at each pixel, the coordinates of that pixel.
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
"""Largest step in depth to a neighbour, over the size of a pixel on the object there, and over the sigma."""
LEAST_NEIGHBOURS = 5
NEAR_OF_CROSSING, FAR_OF_CROSSING = 0.3, 4.0
MIN_CROSSING = 0.2
"""Least depth of the axes' crossing over the baseline; below it the cameras look past each other: axes at 79°."""
NEAR_BASELINES, FAR_BASELINES = 1.0, 60.0
"""Searched depths in baselines, if neither the description nor a crossing of the cameras' axes gives them."""
NARROWER = (1.0, 0.6, 0.35)
"""Shares of that range (of its logarithm, about its middle) that are searched in turn, until curves can follow it."""
ROWS = 256
"""Left rows that are judged together, to limit the memory of the comparison."""


@dataclass(frozen=True, slots=True, eq=False)
class ForeignScan:
    """A foreign image set after reading and decoding, with the tests of its description."""

    description: Description
    rig: ForeignRig
    cameras: Mapping[str, CleanCamera]
    """``left`` and, unless a projector takes its place, ``right``."""
    tested: tuple[ExaminedAssumption, ...]

    @property
    def wrong(self) -> tuple[ExaminedAssumption, ...]:
        """Assumptions that the images contradict."""
        return tuple(assumption for assumption in self.tested if assumption.outcome is Outcome.WRONG)


@dataclass(frozen=True, slots=True, eq=False)
class ForeignCloud:
    """The points of a foreign set on the left image's pixels."""

    cloud: OrganisedCloud
    unchecked: str | None
    """Warning about points that no second direction checked; ``None``: ray gaps have."""
    depths_mm: tuple[float, float]
    """Nearest and farthest searched depth."""
    decoded_pixels: int
    """Number of left pixels with coordinates, but for edges."""
    reason_map: NDArray[np.uint8]
    """(h, w), values of ``Reason``."""
    over_sigma_mm: float
    """Median of the sigmas that were too large; NaN if there were none."""
    failure: str | None
    """Reason why no search was possible; ``None``: it was."""

    @property
    def points(self) -> int:
        """Number of points."""
        return int(np.count_nonzero(self.cloud.mask))

    @property
    def reasons(self) -> dict[Reason, int]:
        """Number of left pixels without a point by reason; the most frequent first."""
        # Count reason by reason: bincount would need eight bytes a pixel instead of one.
        counts = {reason: int(np.count_nonzero(self.reason_map == reason)) for reason in Reason if reason}
        return {reason: counts[reason] for reason in sorted(counts, key=lambda k: -counts[k]) if counts[reason]}

    def largest_reasons(self, *, of_decoded: bool = False) -> list[str]:
        """Return the two most frequent mask reasons, as a line each.

        ``of_decoded``: of pixels with coordinates only.
        """
        counts = {
            reason: count for reason, count in self.reasons.items() if not (of_decoded and reason < Reason.NO_RAY)
        }
        pixels = self.points + sum(counts.values())
        lines = []
        for reason, count in counts.items():
            sigma_text = f", mostly {self.over_sigma_mm:.3g} mm" if reason is Reason.SIGMA else ""
            lines.append(f"{reason.word}: {100.0 * count / pixels:.1f} %{sigma_text} ({reason.text})")
        return lines[:2]


def depths_of(description: Description, rig: StereoRig, index: float) -> tuple[float, float]:
    """Return the searched depths in mm, nearest and farthest, by the description or the cameras' axes."""
    baseline_mm = math.hypot(*rig.right.translation_mm)
    try:
        crossing_mm = float(rig.volume_centre_mm(index)[2])
    except ValueError:
        crossing_mm = math.inf
    if MIN_CROSSING * baseline_mm < crossing_mm < FAR_BASELINES * baseline_mm:
        near_mm, far_mm = NEAR_OF_CROSSING * crossing_mm, FAR_OF_CROSSING * crossing_mm
    else:
        near_mm, far_mm = NEAR_BASELINES * baseline_mm, FAR_BASELINES * baseline_mm
    # Rays begin at the port's outer face.
    port = rig.left.port
    window_mm = 0.0 if rig.left.lens_in_water else 1.05 * (port.distance_mm + port.thickness_mm + 1.0)
    return description.near_mm or max(near_mm, window_mm), description.far_mm or max(far_mm, 2.0 * window_mm)


def find_points(
    description: Description, rig: ForeignRig, left: CleanCamera, right: CleanCamera | None
) -> ForeignCloud:
    """Find the points of the left pixels; without ``right``, the rig's right camera is a projector.

    It raises no error: where there are no points, ``reasons`` and ``failure`` say why.
    """
    lenient = replace(rig.rig, left=_lenient(rig.rig.left), right=_lenient(rig.rig.right))
    reason = left.reason.copy()
    has_coordinates = reason == Reason.FOUND
    decoded_pixels = int(np.count_nonzero(has_coordinates))
    reason[has_coordinates & pixels_without_ray(lenient.left, rig.index)] = Reason.NO_RAY
    has_coordinates &= reason == Reason.FOUND
    reason[has_coordinates] = Reason.NO_MATCH
    depths_mm = depths_of(description, lenient, rig.index)
    if right is None:
        right_maps = {
            name: CoordinateMap(coordinate_px, np.zeros_like(coordinate_px), 1.0)
            for name, coordinate_px in pixel_coordinates(lenient.right).items()
        }
    else:
        right_maps = dict(right.axes)
    failure: str | None = None
    cloud: OrganisedCloud | None = None
    if not has_coordinates.any():
        failure = "no pixel of the left camera has coordinates and a ray"
    elif description.one_direction:
        name = description.axes[0].name
        ends = (description.near_mm, description.far_mm)
        for share in NARROWER[: 1 if None not in ends else None]:
            depths_mm = _narrow(depths_of(description, lenient, rig.index), share)
            try:
                cloud = _one_direction(lenient, rig.index, left, right_maps[name], depths_mm)
            except CurveError as error:
                failure = str(error)
                continue
            failure = None
            break
    elif right is not None and not (right.reason == Reason.FOUND).any():
        failure = "no pixel of the right camera has both coordinates"
    else:
        cloud = points_of_maps(lenient, rig.index, left.axes, right_maps, left.grey, left.modulation_dn, depths_mm)
    cloud = no_points(left.grey) if cloud is None else cloud
    over_sigma_mm = _judge(cloud, reason, depths_mm, lenient.left.lens.f_px[0], description.max_sigma_mm)
    return ForeignCloud(
        cloud,
        UNCHECKED if description.one_direction else None,
        depths_mm,
        decoded_pixels,
        reason,
        over_sigma_mm,
        failure,
    )


def _one_direction(
    rig: StereoRig, index: float, left: CleanCamera, right_map: CoordinateMap, depths_mm: tuple[float, float]
) -> OrganisedCloud:
    """Return the points along epipolar curves. Raises CurveError."""
    (left_map,) = left.axes.values()
    points = match_along_curves(
        left_map.coordinate_px,
        right_map.coordinate_px,
        rig,
        index,
        depths_mm,
        (left_map.sigma_px, right_map.sigma_px),
        OneDirectionLimits(min_neighbours=0),
        partners=False,
    )
    # A copy, as points beyond a limit are removed from the cloud.
    return OrganisedCloud(
        points.points_mm, points.sigma_mm, left.modulation_dn.copy(), np.full_like(points.sigma_mm, np.nan), left.grey
    )


def _judge(
    cloud: OrganisedCloud,
    reason: NDArray[np.uint8],
    depths_mm: tuple[float, float],
    f_px: float,
    max_sigma_mm: float | None,
) -> float:
    """Set the mask reason of each point that breaks a limit, and remove it from the cloud.

    Returns the median of the sigmas that were too large.
    """
    over_mm = [np.zeros(0, np.float32)]
    height, width = reason.shape
    z_mm = np.pad(cloud.points_mm[..., 2], 1, constant_values=np.nan)
    for start in range(0, height, ROWS):
        rows = np.s_[start : min(start + ROWS, height)]
        z = z_mm[1:-1, 1:-1][rows]
        # Size of a pixel on the object there.
        pixel_mm = np.abs(z) / np.float32(f_px)
        # The slope of the surface makes a step in proportion to the size of a pixel; noise adds to it.
        max_step_mm = np.fmax(np.float32(STEP_PIXELS) * pixel_mm, np.float32(STEP_SIGMAS) * cloud.sigma_mm[rows])
        near = np.zeros(z.shape, np.uint8)
        for j, i in ((0, 0), (0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1), (2, 2)):
            neighbour_z = z_mm[j : j + height, i : i + width][rows]
            near += np.abs(neighbour_z - z) <= max_step_mm
        allowed_sigma_mm = SIGMA_PIXELS * pixel_mm if max_sigma_mm is None else max_sigma_mm
        broken = {
            Reason.NEIGHBOURS: near < LEAST_NEIGHBOURS,
            Reason.DEPTH: (z < depths_mm[0]) | (z > depths_mm[1]),
            Reason.SIGMA: cloud.sigma_mm[rows] > allowed_sigma_mm,
            Reason.GAP: cloud.ray_gap_mm[rows] > GAP_PIXELS * pixel_mm,
        }
        # A point that breaks several limits keeps the last of them: a ray gap counts before depth and sigma.
        row_reasons = np.where(np.isfinite(z), np.uint8(Reason.FOUND), reason[rows])
        for rule, breaks in broken.items():
            row_reasons[np.isfinite(z) & breaks] = rule
        reason[rows] = row_reasons
        over_mm.append(cloud.sigma_mm[rows][row_reasons == Reason.SIGMA])
        for values in (cloud.points_mm, cloud.sigma_mm, cloud.ray_gap_mm, cloud.modulation_dn):
            values[rows][row_reasons != Reason.FOUND] = np.nan
    sigmas_mm = np.concatenate(over_mm)
    return float(np.median(sigmas_mm)) if sigmas_mm.size else math.nan


def _lenient(camera: HousedCamera) -> HousedCamera:
    """Return the camera with a lens that has no rays where its distortion folds over, instead of an error.

    Foreign cameras are not calibrated again.
    """
    lens = camera.lens
    return replace(camera, lens=FoldingLens(lens.f_px, lens.c_px, lens.distortion))


def _narrow(depths_mm: tuple[float, float], share: float) -> tuple[float, float]:
    """Return a part of the range about its middle."""
    middle_mm = math.sqrt(depths_mm[0] * depths_mm[1])
    return middle_mm * (depths_mm[0] / middle_mm) ** share, middle_mm * (depths_mm[1] / middle_mm) ** share


def pixel_coordinates(projector: HousedCamera) -> dict[str, Floats]:
    """Return the coordinates of each pixel of a projector, as the maps that its "image" has."""
    v, u = np.mgrid[0 : projector.height_px, 0 : projector.width_px].astype(np.float32)
    return {"x": u, "y": v}
