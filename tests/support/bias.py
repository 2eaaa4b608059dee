"""Owns how far a simulated scan is from the truth: pattern coordinates of each camera, correspondence, and depth.

All three at the pixel: its true point is where its exact ray meets the true surface, so nothing has to be fitted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.points.pipeline import Cloud, Pipeline
from hw_sim.rendering.render import Renderer
from hw_sim.truth import TrueRig, project, ray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CoordinateErrors:
    """Of one camera's valid pixels that all eyes see, n of them."""

    at: NDArray[np.bool_]
    """(h, w): which pixels."""
    true_px: Array
    """(n, 2): pattern coordinate that lights the pixel's point."""
    error_px: Array
    """(n, 2): decoded minus true, in pattern px."""


@dataclass(frozen=True, slots=True)
class DepthErrors:
    """Of a cloud's points."""

    along_ray_mm: Array
    """(n,): how much too far along the pixel's ray."""
    correspondence_px: Array
    """(n,): the same as an error of the right image point, in px across the baseline."""
    true_px: Array
    """(n, 2): pattern coordinate of the true point."""
    seen: NDArray[np.bool_]
    """(n,): all eyes see the true point."""


def coordinate_errors(renderer: Renderer, pipeline: Pipeline, side: str) -> CoordinateErrors:
    """What phase and fringe order made of the pattern coordinate."""
    view, decoded = renderer.view(side, 0.0), pipeline.decoded(side)
    at = view.seen_by_all & np.isfinite(decoded.p_px) & np.isfinite(decoded.q_px)
    found = np.stack([decoded.p_px[at], decoded.q_px[at]], -1).astype(np.float64)
    true = view.projector_px[at]
    return CoordinateErrors(at, true, found - true)


def depth_errors(renderer: Renderer, cloud: Cloud) -> DepthErrors:
    """What reached the points."""
    truth = renderer.truth
    view = renderer.view("left", 0.0)
    v, u = np.divmod(cloud.pixel.astype(np.int64), truth.left.width_px)
    points = np.asarray(cloud.points_mm, np.float64) @ np.array(truth.left.R).T + np.array(truth.left.t_mm)
    true = view.points_rig_mm[v, u]
    _, direction = ray(truth, "left", np.stack([u, v], -1))
    along = np.sum((points - true) * direction, -1)
    shift = project(truth, "right", true + 0.5 * direction) - project(truth, "right", true - 0.5 * direction)
    return DepthErrors(along, along * shift[:, 0], view.projector_px[v, u], view.seen_by_all[v, u])


def rms(values: Array) -> float:
    """Root of the mean square of what is finite."""
    return float(np.sqrt(np.nanmean(values**2)))


def ripple(error: Array, true_px: Array, period_px: int, cycles: int = 4) -> float:
    """Amplitude of ``error`` (n,) at ``cycles`` per period of the coordinate ``true_px`` (n,), in the error's unit."""
    good = np.isfinite(error) & np.isfinite(true_px)
    angle = 2.0 * np.pi * cycles * (true_px[good] + 0.5) / period_px
    return float(2.0 * abs(np.mean((error[good] - error[good].mean()) * np.exp(-1j * angle))))


__all__ = ["CoordinateErrors", "DepthErrors", "TrueRig", "coordinate_errors", "depth_errors", "ripple", "rms"]
