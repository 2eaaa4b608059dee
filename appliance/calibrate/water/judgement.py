"""Owns what is said about an adjustment: which parameters the data reached, and when the model does not fit them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure import HousedCamera, PatchGaps

Array = NDArray[np.float64]

STILL_PRIOR = 0.9
"""A parameter whose standard deviation shrank to no less than this share of the prior's was not observed."""
FAR_FROM_PRIOR = 3.5
TOO_NOISY = 1.5
FEWEST_IN_PATCH = 10
_COUPLED = (" k1", " k2", " k3", " p1", " p2")
"""Distortion coefficients follow what a lens does beyond them, and each other: alone they mean nothing.

What they miss is in the systematic rest.
"""
SYSTEMATIC_SHARE = 0.5
"""Share of the noise from which a systematic residual is worth a warning."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """One parameter: its change and what is known about it."""

    name: str
    change: float
    prior_sd: float
    sd: float

    @property
    def at_prior(self) -> bool:
        """The recordings say nothing about it."""
        return self.sd > STILL_PRIOR * self.prior_sd


def judged(names: Sequence[str], change: Array, prior_sd: Array, sd: Array) -> tuple[Estimate, ...]:
    """Return one estimate per parameter."""
    return tuple(
        Estimate(n, float(c), float(p), float(s)) for n, c, p, s in zip(names, change, prior_sd, sd, strict=True)
    )


def systematic_px(
    left_px: Array, residual_px: Array, camera: HousedCamera, recording: NDArray[np.intp] | None = None
) -> float:
    """Return the RMS per coordinate of the patches' mean residuals, less what noise alone leaves in such means.

    ``recording`` (n,), the recording of each point: means of each recording for itself; ``None``: over all together.
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
    may_be_refined: bool,
) -> tuple[float, tuple[str, ...]]:
    """Return the systematic rest in px, and warnings in words: noise, systematic rest, priors left far behind,
    lengths."""
    found = []
    rms = float(np.sqrt(np.mean(residual_px**2)))
    if rms > TOO_NOISY * noise_px:
        found.append(
            f"residual {rms:.3f} px, expected {noise_px:.3f} px: the model does not explain the recordings; check the "
            f"water settings, the certificates and the motion during the recordings"
        )
    rest = systematic_px(left_px, residual_px, camera)
    if rest > SYSTEMATIC_SHARE * noise_px:
        remedy = "adjust with the image correction" if may_be_refined else "record more planes, over the whole volume"
        found.append(f"{rest:.3f} px remain systematically over the image: lens or port are not as modelled; {remedy}")
    found += [
        f"{e.name} changed by {e.change:.4g}, its prior allows ±{e.prior_sd:.2g}: check the rig file and the housing"
        for e in estimates
        if abs(e.change) > FAR_FROM_PRIOR * e.prior_sd and not e.name.endswith(_COUPLED)
    ]
    found += [
        f"recording {name}: the length is {off:+.1f} standard deviations off its certificate"
        for name, off in lengths
        if abs(off) > FAR_FROM_PRIOR
    ]
    return rest, tuple(found)
