"""Owns where the projector is: fitted to what one scan says of it, so that nobody has to calibrate it.

The projector is modelled as a camera that sends. The fit starts from the drawing (in the middle between the cameras,
towards the middle of the volume, behind the same port), whose tolerances are its prior, and the pattern coordinates of
the scan's own points do the rest. On the surface the model is then as good as the points; off it, within the tolerances
of the mounting.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.model import HousedCamera, StereoRig
from appliance.measure.light.noise import MAD_TO_SIGMA
from appliance.measure.light.pinhole import Lens
from appliance.measure.light.port import Port
from appliance.measure.light.rotation import matrix3, rotation_matrix

Array = NDArray[np.float64]

MIN_POINTS = 200
ITERATIONS = 6
NOISE_PX = 0.1
"""Least standard deviation of a coordinate, for the weight of points against the priors: noise, and what is smooth
beyond the model."""
CAUCHY_SIGMAS = 3.0
"""Residuals beyond so many robust standard deviations count less."""
# The unknowns: rotation vector (rad), place (mm), log focal length, principal point (px), k1 k2 p1 p2, port distance
# (mm), port tilt. Standard deviations of their priors, by the drawing's tolerances, and steps of their difference
# quotients.
_PRIOR_SD = np.array([0.02, 0.02, 0.02, 1.5, 1.5, 1.5, 0.2, 15.0, 15.0, 0.1, 0.1, 1e-3, 1e-3, 3.0, 0.01, 0.01])
_STEP = np.array([1e-5] * 3 + [1e-3] * 3 + [1e-5] + [1e-2] * 2 + [1e-4] * 4 + [1e-2] + [1e-5] * 2)


class ShownPoints(NamedTuple):
    """Points of one scan, and what the projector showed there."""

    water_index: float
    points_mm: Array
    """(n, 3) in the left camera frame."""
    pattern_px: Array
    """(n, 2) decoded pattern coordinates."""


@dataclass(frozen=True, slots=True)
class FittedProjector:
    """The projector as a camera in the left camera frame, and how well the points fit it."""

    camera: HousedCamera
    residual_px: float
    """Robust standard deviation of a coordinate against the model."""


def fit_projector(
    rig: StereoRig, water_index: float, points_mm: Array, pattern_px: Array, size_px: tuple[int, int]
) -> FittedProjector:
    """Fit the projector to points (n, 3) mm in the left camera frame and their pattern coordinates (n, 2) px.

    ``size_px`` are width and height of the pattern. Raises ValueError for fewer than ``MIN_POINTS`` points.
    """
    return fit_projector_to(rig, [ShownPoints(water_index, points_mm, pattern_px)], size_px)


def fit_projector_to(rig: StereoRig, scans: Sequence[ShownPoints], size_px: tuple[int, int]) -> FittedProjector:
    """Fit the projector to the points of several scans, as ``fit_projector`` does to those of one."""
    points_mm = np.concatenate([one.points_mm for one in scans])
    pattern_px = np.concatenate([one.pattern_px for one in scans])
    if len(points_mm) < MIN_POINTS:
        raise ValueError(
            f"{len(points_mm)} points are on the projector's light; needed are {MIN_POINTS}; scan more of the object"
        )
    drawn = _drawn(rig, scans[0].water_index, points_mm, pattern_px, size_px)
    values = np.zeros(len(_PRIOR_SD))
    residual = _residuals(drawn, values, scans)
    scale_px = _scale(residual)
    for _ in range(ITERATIONS):
        # Gauss-Newton: J by differences, Cauchy weights, the priors as one more residual each.
        columns = []
        for k, step in enumerate(_STEP):
            moved = values.copy()
            moved[k] += step
            columns.append(((_residuals(drawn, moved, scans) - residual) / step).ravel())
        J = np.stack(columns, -1)
        weight = 1.0 / (max(scale_px, NOISE_PX) ** 2 * (1.0 + (residual.ravel() / (CAUCHY_SIGMAS * scale_px)) ** 2))
        A = (J * weight[:, None]).T @ J + np.diag(1.0 / _PRIOR_SD**2)
        b = (J * weight[:, None]).T @ residual.ravel() + values / _PRIOR_SD**2
        step_taken = -np.linalg.solve(A, b)
        values = values + step_taken
        residual = _residuals(drawn, values, scans)
        scale_px = _scale(residual)
        if np.all(np.abs(step_taken) < 1e-3 * _PRIOR_SD):
            break
    return FittedProjector(_changed(drawn, values), scale_px)


def _drawn(
    rig: StereoRig, water_index: float, points_mm: Array, pattern_px: Array, size_px: tuple[int, int]
) -> HousedCamera:
    """Return the projector as the drawing has it; only its focal length (px) is taken from the points."""
    baseline = np.asarray(rig.right.translation_mm)
    place = 0.5 * baseline
    z = rig.volume_centre_mm(water_index) - place
    z /= np.linalg.norm(z)
    x = baseline - (baseline @ z) * z
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z], -1)
    width_px, height_px = size_px
    centre = ((width_px - 1) / 2.0, (height_px - 1) / 2.0)
    port = replace(rig.left.port, normal=(0.0, 0.0, 1.0))
    camera = HousedCamera(
        width_px,
        height_px,
        Lens((1.0, 1.0), centre),
        port,
        matrix3(R),
        (float(place[0]), float(place[1]), float(place[2])),
        lens_in_water=rig.left.lens_in_water,
    )
    seen = camera.project(points_mm, water_index) - np.asarray(centre)
    shown = pattern_px - np.asarray(centre)
    # Spread against spread: an offset is left to the pose.
    f_px = float(np.median(np.abs(shown - np.median(shown, 0))) / np.median(np.abs(seen - np.median(seen, 0))))
    return replace(camera, lens=Lens((f_px, f_px), centre))


def _changed(drawn: HousedCamera, values: Array) -> HousedCamera:
    """Return the drawn projector with the increments ``values`` (16,), in the order of ``_PRIOR_SD``."""
    turn, shift, log_f, c, brown, d_mm, tilt = np.split(values, np.cumsum([3, 3, 1, 2, 4, 1]))
    f_px = drawn.lens.f_px[0] * float(np.exp(log_f[0]))
    R = np.asarray(drawn.rotation) @ rotation_matrix(turn)
    t = np.asarray(drawn.translation_mm) + shift
    normal = np.array([tilt[0], tilt[1], 1.0])
    normal /= np.linalg.norm(normal)
    k1, k2, p1, p2 = (float(v) for v in brown)
    return replace(
        drawn,
        lens=Lens(
            (f_px, f_px), (drawn.lens.c_px[0] + float(c[0]), drawn.lens.c_px[1] + float(c[1])), (k1, k2, p1, p2, 0.0)
        ),
        port=Port(
            (float(normal[0]), float(normal[1]), float(normal[2])),
            max(drawn.port.distance_mm + float(d_mm[0]), 0.0),
            drawn.port.thickness_mm,
            drawn.port.glass_index,
        ),
        rotation=matrix3(R),
        translation_mm=(float(t[0]), float(t[1]), float(t[2])),
    )


def _residuals(drawn: HousedCamera, values: Array, scans: Sequence[ShownPoints]) -> Array:
    """Return the differences (n, 2) px of modelled and decoded coordinates; 0 where a point is not seen."""
    camera = _changed(drawn, values)
    return np.concatenate(
        [np.nan_to_num(camera.project(one.points_mm, one.water_index) - one.pattern_px) for one in scans]
    )


def _scale(residual: Array) -> float:
    """Return the robust standard deviation in px."""
    return max(MAD_TO_SIGMA * float(np.median(np.abs(residual))), 1e-3)
