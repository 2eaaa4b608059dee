"""Errors of points at borders of albedo, with and without a flag or a correction.

A pixel returns the mean of its footprint, weighted by the light. Beside a border the weighted mean lies off the pixel's
middle by σ² ∇ln(albedo) (σ: that of the blur), and so does its phase. Both cameras see the same albedo, so that most of
it cancels in the correspondence; the part by different foreshortening remains.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bench.phase_bias.conditions import UM, ReconstructedScan
from tests.support.bias import rms

BLUR_VAR_PX2 = 0.55**2 + (0.3 * 0.4875) ** 2
"""Variance of the blur of the simulated lens and water, in px² of 1600 px, which a correction would need."""
BORDER_CONTRAST = 0.10
"""Relative change of light per px from which on a pixel is called a border."""


class Maps(Protocol):
    """Decoded coordinates of one camera, (h, w)."""

    p_px: NDArray[np.float32]
    q_px: NDArray[np.float32]


def borders(scan: ReconstructedScan) -> dict[str, float]:
    """Return errors in µm on and off borders, and without the border points."""
    is_border = contrast(scan)[scan.cloud.pixel] > BORDER_CONTRAST
    keep, along = scan.is_visible, UM * scan.errors.along_ray_mm
    return {
        "border points, %": 100.0 * float(np.mean(is_border[keep])),
        "rms off borders, µm": rms(along[keep & ~is_border]),
        "rms on borders, µm": rms(along[keep & is_border]),
        "all, µm": rms(along[keep]),
        "worst 0.1 %, µm": float(np.quantile(np.abs(along[keep]), 0.999)),
        "worst 0.1 % off borders, µm": float(np.quantile(np.abs(along[keep & ~is_border]), 0.999)),
    }


def contrast(scan: ReconstructedScan) -> NDArray[np.float64]:
    """Return the relative gradient of the left image's light per px, flat: the criterion of a flag."""
    frames, sequence = scan.scan.frames["left"], scan.scan.sequence
    light = frames[sequence.bright].astype(np.float64) - frames[sequence.dark]
    by_v, by_u = np.gradient(light)
    return np.asarray(np.hypot(by_u, by_v) / np.maximum(light, 1.0)).reshape(-1)


def correct(decoded: Maps, bright: NDArray[np.uint8], dark: NDArray[np.uint8]) -> None:
    """Take σ² ∇ln(light) · ∇coordinate off decoded coordinates, in place: the first-order correction."""
    by_v, by_u = np.gradient(np.log(np.maximum(bright.astype(np.float64) - dark, 1.0)))
    for m in (decoded.p_px, decoded.q_px):
        m_v, m_u = np.gradient(m.astype(np.float64))
        shift = BLUR_VAR_PX2 * (m_u * by_u + m_v * by_v)
        m -= np.where(np.isfinite(shift), shift, 0.0).astype(np.float32)
