"""The hands of a person at a computer: a mouse moves the instrument before the object.

One held button shifts it, the other rotates it about the middle of the volume, the wheel moves it nearer and farther.
While a sequence is recorded the hands keep the speed at its beginning, since a recording slower than real time could
not follow them.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hw_sim.objects.motion import PIVOT_MM, pose_matrix
from hw_sim.scene import Scene

Pose = tuple[float, float, float, float, float, float]
MM_PER_PX, DEG_PER_PX, MM_PER_NOTCH = 0.5, 0.15, 5.0
"""Gains of the mouse: a camera's image is 400 px wide and shows some 250 mm."""
MEMORY_NS = 150_000_000
"""Time over which the speed of the hands is averaged."""
LIMIT_MM, NEAREST_MM, FARTHEST_MM = 300.0, 250.0, 1500.0


class Held(Protocol):
    """The part of a world that hands move."""

    @property
    def scene(self) -> Scene: ...

    @property
    def recording(self) -> bool: ...

    def set_scene(self, scene: Scene) -> None: ...


class Hands:
    """Moves of the mouse in, poses of the object and speeds of the hands out. One thread."""

    def __init__(self, world: Held) -> None:
        self._world = world
        self._lately: deque[tuple[int, NDArray[np.float64]]] = deque()
        """(real time, shift in mm and turn in degrees), newest last."""
        self._waiting = np.zeros(6)
        """Shift, mm, and turn, degrees, since the last change of the scene."""
        self._moving = False

    def shift(self, dx_px: float, dy_px: float, real_ns: int) -> None:
        """Shift the instrument right and down with the mouse (left button)."""
        self._did(np.array([dx_px * MM_PER_PX, dy_px * MM_PER_PX, 0.0, 0.0, 0.0, 0.0]), real_ns)

    def turn(self, dx_px: float, dy_px: float, real_ns: int) -> None:
        """Rotate it so that it sees the same place from further right and down (right button)."""
        self._did(np.array([0.0, 0.0, 0.0, dy_px * DEG_PER_PX, -dx_px * DEG_PER_PX, 0.0]), real_ns)

    def wheel(self, notches: float, real_ns: int) -> None:
        """Move it nearer (positive) or farther, ``MM_PER_NOTCH`` each."""
        self._did(np.array([0.0, 0.0, notches * MM_PER_NOTCH, 0.0, 0.0, 0.0]), real_ns)

    def _did(self, change: NDArray[np.float64], real_ns: int) -> None:
        self._lately.append((real_ns, change))
        self._waiting += change

    def settle(self, real_ns: int) -> None:
        """Update the scene; call it often, also for hands at rest."""
        while self._lately and self._lately[0][0] < real_ns - MEMORY_NS:
            self._lately.popleft()
        if self._world.recording or not (self._moving or self._waiting.any()):
            return
        # A mean over the memory, since a single event of the mouse gives no speed.
        speed = sum((change for _, change in self._lately), np.zeros(6)) / (MEMORY_NS / 1e9)
        scene = self._world.scene
        vx, vy, vz, wx, wy, wz = (float(part) for part in speed)
        motion = replace(scene.motion, velocity_mm_s=(vx, vy, vz), rotation_deg_s=(wx, wy, wz))
        self._world.set_scene(replace(scene, pose=seen_after(scene.start_pose, self._waiting), motion=motion))
        self._moving = bool(speed.any())
        self._waiting[:] = 0.0


def seen_after(pose: Pose, change: NDArray[np.float64]) -> Pose:
    """Return an object's pose in the instrument's frame after the instrument has moved.

    ``change``: shift (mm) and rotation (degrees about the pivot).
    """
    R, t = pose_matrix(pose)
    rotation, shift = pose_matrix(tuple(float(part) for part in (*change[:3], *change[3:])))
    R = rotation.T @ R if change[3:].any() else R
    t = rotation.T @ (t - shift - PIVOT_MM) + PIVOT_MM
    x, y, z = np.clip(t, (-LIMIT_MM, -LIMIT_MM, NEAREST_MM), (LIMIT_MM, LIMIT_MM, FARTHEST_MM))
    # Back to angles of R = Rz Ry Rx; the singularity at ry = ±90° is out of the mouse's reach.
    rx = math.degrees(math.atan2(R[2, 1], R[2, 2]))
    ry = math.degrees(math.asin(max(-1.0, min(1.0, -R[2, 0]))))
    rz = math.degrees(math.atan2(R[1, 0], R[0, 0]))
    return float(x), float(y), float(z), rx, ry, rz
