"""Judgement of an adjustment: which parameters were observable, and whether the model fits the recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure import HousedCamera, PatchGaps

Array = NDArray[np.float64]

STILL_PRIOR = 0.9
"""A parameter was not observable if its standard deviation is more than this share of that of the prior."""
FAR_FROM_PRIOR = 3.5
TOO_NOISY = 1.5
FEWEST_IN_PATCH = 10
_COUPLED = (" k1", " k2", " k3", " p1", " p2")
"""Distortion coefficients, which compensate errors of the model and each other: a single one means nothing.

Errors that they do not cover show as systematic residuals.
"""
SYSTEMATIC_SHARE = 0.5
"""Share of the noise above which a systematic residual gives a warning."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """Change of one parameter, with its standard deviation before and after."""

    name: str
    change: float
    prior_sd: float
    sd: float

    @property
    def at_prior(self) -> bool:
        """True if the recordings do not determine the parameter."""
        return self.sd > STILL_PRIOR * self.prior_sd


def estimates_of(names: Sequence[str], change: Array, prior_sd: Array, sd: Array) -> tuple[Estimate, ...]:
    """Return one estimate per parameter."""
    return tuple(
        Estimate(n, float(c), float(p), float(s)) for n, c, p, s in zip(names, change, prior_sd, sd, strict=True)
    )


def systematic_px(
    left_px: Array, residual_px: Array, camera: HousedCamera, recording: NDArray[np.intp] | None = None
) -> float:
    """Return the RMS per coordinate of the patches' mean residuals, without the contribution of noise.

    ``recording`` (n,) is the recording of each point, for means of each recording by itself; ``None``: over all
    together.
    """
    patch = PatchGaps.patch_of(left_px, (camera.width_px, camera.height_px))
    if recording is not None:
        patch = patch + recording * PatchGaps.COUNT
    excess, count = 0.0, 0
    for k in np.unique(patch):
        inside = residual_px[patch == k]
        n = len(inside)
        if n < FEWEST_IN_PATCH:
            continue
        mean = inside.mean(axis=0)
        # A patch's mean of n residuals has the noise variance s²/n on top of its systematic part; it is subtracted
        # before the root, so that pure noise gives zero in the mean.
        excess += n * float(np.sum(mean**2 - inside.var(axis=0, ddof=1) / n))
        count += 2 * n
    return float(np.sqrt(max(excess / count, 0.0))) if count else 0.0


def warnings_about(
    left_px: Array,
    residual_px: Array,
    noise_px: float,
    camera: HousedCamera,
    estimates: Sequence[Estimate],
    lengths: Sequence[tuple[str, float]],
    is_refinable: bool,
) -> tuple[float, tuple[str, ...]]:
    """Return the systematic residual in px, and warnings about noise, systematic residuals, priors and lengths."""
    warnings = []
    rms = float(np.sqrt(np.mean(residual_px**2)))
    if rms > TOO_NOISY * noise_px:
        warnings.append(
            f"residual {rms:.3f} px, expected {noise_px:.3f} px: the model does not explain the recordings; check the "
            f"water settings, the certificates and the motion during the recordings"
        )
    systematic = systematic_px(left_px, residual_px, camera)
    if systematic > SYSTEMATIC_SHARE * noise_px:
        remedy = "adjust with the image correction" if is_refinable else "record more planes, over the whole volume"
        warnings.append(
            f"{systematic:.3f} px of systematic residuals over the image: lens or port differ from the model; {remedy}"
        )
    warnings += [
        f"{e.name} changed by {e.change:.4g}, its prior allows ±{e.prior_sd:.2g}: check the rig file and the housing"
        for e in estimates
        if abs(e.change) > FAR_FROM_PRIOR * e.prior_sd and not e.name.endswith(_COUPLED)
    ]
    warnings += [
        f"recording {name}: the length is {off:+.1f} standard deviations from its certificate; check the certificate"
        for name, off in lengths
        if abs(off) > FAR_FROM_PRIOR
    ]
    return systematic, tuple(warnings)
