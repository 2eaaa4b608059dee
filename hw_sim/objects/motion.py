"""Motion of the diver's hands with the instrument, and the resulting pose of an object at a moment."""

# Symbols:
#   R0, t0    pose of the object before anything moved: p_rig = R0 p_object + t0
#   v, a      velocity and acceleration of the rig, mm/s and mm/s²; omega the tremor's angular frequency, rad/s
#   rotation, shift   motion of the rig since: p_rig_then = rotation (p_rig_now − pivot) + pivot + shift

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SWAY_MM, SWAY_S = 50.0, 1.0
"""Amplitude of hands that move while aiming; its duration if they only tremble or rotate."""
PIVOT_MM = np.array([0.0, 0.0, 522.5])


@dataclass(frozen=True, slots=True)
class Motion:
    """Rigid motion of the rig in its own frame, from time 0 on; rotation is about the middle of the volume.

    Raises ValueError for a vector that has not three finite numbers.
    """

    velocity_mm_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    acceleration_mm_s2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tremor_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tremor_hz: float = 6.0
    rotation_deg_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    aiming: int = 0
    """1: the hands also move in live images, to and fro over ``SWAY_MM``; 0: they are at rest there."""

    def __post_init__(self) -> None:
        for name in ("velocity_mm_s", "acceleration_mm_s2", "tremor_mm", "rotation_deg_s"):
            value = getattr(self, name)
            if len(value) != 3 or not all(math.isfinite(part) for part in value):
                raise ValueError(f"motion: {name} = {value}; give three finite numbers: x, y, z of the rig frame")
        if not 0.0 < self.tremor_hz <= 30.0:
            raise ValueError(f"motion: tremor_hz = {self.tremor_hz}; allowed are 0..30 (hands shake at 4 to 12)")
        if self.aiming not in (0, 1):
            raise ValueError(f"motion: aiming = {self.aiming}; allowed are 0 (at rest in live views) and 1")

    @property
    def still(self) -> bool:
        """True if there is no motion."""
        return not any((*self.velocity_mm_s, *self.acceleration_mm_s2, *self.tremor_mm, *self.rotation_deg_s))


def swayed_s(motion: Motion, clock_s: float) -> float:
    """Return the time of the motion, s, for a live image at ``clock_s``; 0 if the hands are at rest.

    It runs to and fro so that the object stays in sight.
    """
    if not motion.aiming:
        return 0.0
    speed_mm_s = math.hypot(*motion.velocity_mm_s)
    # A triangle wave between 0 and way_s.
    way_s = SWAY_MM / speed_mm_s if speed_mm_s > 0.0 else SWAY_S
    return way_s - abs(clock_s % (2.0 * way_s) - way_s)


def pose_matrix(pose: tuple[float, ...]) -> tuple[Array, Array]:
    """Return rotation (3, 3) = Rz Ry Rx and translation (3,), mm, of a pose: object frame → rig frame.

    A pose is [x, y, z, rx_deg, ry_deg, rz_deg].
    """
    x, y, z, *angles = pose
    return _euler(tuple(math.radians(a) for a in angles)), np.array([x, y, z])


def object_pose(pose: tuple[float, ...], motion: Motion, time_s: float) -> tuple[Array, Array]:
    """Return rotation (3, 3) and translation (3,), mm, of the object in the moved rig frame at ``time_s``."""
    R0, t0 = pose_matrix(pose)
    if motion.still or time_s == 0.0:
        return R0, t0
    v, a, tremor = (np.array(x) for x in (motion.velocity_mm_s, motion.acceleration_mm_s2, motion.tremor_mm))
    phases = np.array([0.0, 2.1, 4.2])
    omega = 2 * math.pi * motion.tremor_hz
    # s = v t + a t²/2 + A (sin(ωt + φ) − sin φ): at time 0 nothing has moved. Each axis trembles in its own phase.
    shift = v * time_s + 0.5 * a * time_s**2 + tremor * (np.sin(omega * time_s + phases) - np.sin(phases))
    rotation = _euler(tuple(math.radians(w) * time_s for w in motion.rotation_deg_s))
    # Rig point = rotation · (moved rig's point − pivot) + pivot + shift, inverted for the object.
    return rotation.T @ R0, rotation.T @ (t0 - shift - PIVOT_MM) + PIVOT_MM


def _euler(angles_rad: tuple[float, ...]) -> Array:
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles_rad), np.sin(angles_rad)
    Rx = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
    Ry = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    Rz = np.array([[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(Rz @ Ry @ Rx)
