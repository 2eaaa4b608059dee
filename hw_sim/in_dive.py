"""Effects of heat and depth on the true rig: rotation of the mounts, and bending of the ports."""

from __future__ import annotations

from dataclasses import replace

from hw_sim.optics.aberrations import Aberrations
from hw_sim.optics.mounts import EYES, Mounts
from hw_sim.truth import TrueEye, TrueRig, turned

REFERENCE_C = 20.0
"""Temperature of the case at which a rig has its drawn values."""
NOTICED_K = 0.5
"""Step of the temperature that the rig follows: 0.0005° at most."""


def in_dive(rig: TrueRig, mounts: Mounts, warm_k: float) -> TrueRig:
    """Return the rig ``warm_k`` above ``REFERENCE_C`` at the depth of ``mounts``.

    Each eye rotates about its projection centre together with its port. In air (a rig whose water has the index 1)
    there is no depth.
    """
    eyes = {name: _warmed(rig.eye(name), mounts, name, warm_k, rig.n_water) for name in EYES}
    return replace(rig, left=eyes["left"], right=eyes["right"], projector=eyes["projector"])


def _warmed(eye: TrueEye, mounts: Mounts, name: str, warm_k: float, n_water: float) -> TrueEye:
    per_k = mounts.turn_of(name)
    eye = turned(eye, (per_k[0] * warm_k, per_k[1] * warm_k, per_k[2] * warm_k))
    grown = 1.0 + mounts.focal_per_k * warm_k
    bend_per_mm = mounts.window_bend_per_mm(eye.port.th_mm) if n_water > 1.0 else 0.0
    flaws = eye.aberrations
    if bend_per_mm > 0.0:
        flaws = replace(flaws or Aberrations(), window_bend_per_mm=bend_per_mm)
    return replace(eye, f_px=(eye.f_px[0] * grown, eye.f_px[1] * grown), aberrations=flaws)
