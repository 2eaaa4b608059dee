"""A knock: a camera of the true rig is permanently rotated and displaced in its mount.

    <left|right> [pitch_deg=<a>] [yaw_deg=<a>] [roll_deg=<a>] [x_mm=<s>] [y_mm=<s>] [z_mm=<s>]

Rotations are about the camera's x (pitch), y (yaw) and z (roll) axes, displacements along them. Its port moves with it,
as in the instrument, whose ports are tilted with the cameras.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hw_sim.truth import TrueRig, turned

SIDES = ("left", "right")
LIMITS = {"deg": 5.0, "mm": 20.0}


class MountShiftError(ValueError):
    """A knock cannot be parsed; the text has the allowed form."""

    exit_code = 2


@dataclass(frozen=True, slots=True)
class MountShift:
    """One shift of one camera: rotations about its axes, then a displacement along them."""

    camera: str
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    roll_deg: float = 0.0
    x_mm: float = 0.0
    y_mm: float = 0.0
    z_mm: float = 0.0


AMOUNTS = ("pitch_deg", "yaw_deg", "roll_deg", "x_mm", "y_mm", "z_mm")


def parse(sentence: str) -> MountShift:
    """Return the shift of a ``knock`` sentence. Raises MountShiftError."""
    camera, *assignments = [*sentence.split(), ""]
    if camera not in SIDES:
        raise MountShiftError(f"knock '{sentence}': camera '{camera}'; allowed are {', '.join(SIDES)}")
    amounts: dict[str, float] = {}
    for assignment in filter(None, assignments):
        name, _, value = assignment.partition("=")
        try:
            amount = float(value)
        except ValueError:
            amount = math.nan
        limit = LIMITS.get(name.rpartition("_")[2], 0.0)
        if name not in AMOUNTS or not abs(amount) <= limit:
            raise MountShiftError(
                f"knock '{sentence}': '{assignment}' is not understood; allowed are {', '.join(AMOUNTS)} = a number, "
                f"up to {LIMITS['deg']:g} degrees or {LIMITS['mm']:g} mm"
            )
        amounts[name] = amount
    if not amounts:
        raise MountShiftError(f"knock '{sentence}': no amount; give one of {', '.join(AMOUNTS)}")
    return MountShift(camera, **amounts)


def with_mount_shifted(rig: TrueRig, shift: MountShift) -> TrueRig:
    """Return the rig after the shift: camera and port moved together."""
    eye = rig.eye(shift.camera)
    R = np.array(eye.R)
    # The displacement is along the axes before the rotation.
    t = np.array(eye.t_mm) + R @ np.array([shift.x_mm, shift.y_mm, shift.z_mm])
    moved = replace(
        turned(eye, (shift.pitch_deg, shift.yaw_deg, shift.roll_deg)), t_mm=(float(t[0]), float(t[1]), float(t[2]))
    )
    return replace(rig, left=moved) if shift.camera == "left" else replace(rig, right=moved)
