"""The check whether a calibration belongs to an instrument: serial numbers and image sizes.

A calibration describes two lenses behind two ports. With another camera in the housing it is wrong, and lengths are
wrong by percents while every image looks right.
"""

from __future__ import annotations

from dataclasses import dataclass

from appliance.measure.calibration.file import Calibration
from appliance.measure.light.sides import SIDES


@dataclass(frozen=True, slots=True)
class Owner:
    """An instrument, as a rig file or a stored scan states it."""

    rig_serial: str
    sizes_px: tuple[tuple[int, int], tuple[int, int]]
    """Width and height of the left and of the right camera's images."""
    camera_serials: tuple[str, str] | None
    """Serial numbers of the left and the right camera; ``None``: unknown."""


@dataclass(frozen=True, slots=True)
class Misfit:
    """Reason why a calibration does not belong to an instrument."""

    reason: str
    exchanged: tuple[str, ...] = ()
    """Sides (``left``, ``right`` or both) whose cameras were exchanged, if nothing else differs."""


def owner_misfit(calibration: Calibration, owner: Owner) -> Misfit | None:
    """Return why ``calibration`` does not belong to ``owner``; ``None`` if no difference is known."""
    if calibration.rig_serial != owner.rig_serial:
        return Misfit(f"the calibration is of instrument {calibration.rig_serial}; this one is {owner.rig_serial}")
    cameras = (calibration.rig.left, calibration.rig.right)
    for side, camera, wanted_px in zip(SIDES, cameras, owner.sizes_px, strict=True):
        if (camera.width_px, camera.height_px) != wanted_px:
            return Misfit(
                f"the calibration's {side} camera has {camera.width_px}x{camera.height_px} px, "
                f"the rig's {wanted_px[0]}x{wanted_px[1]}"
            )
    return exchanged(calibration.camera_serials, owner.camera_serials)


def exchanged(calibrated: tuple[str, str] | None, connected: tuple[str, str] | None) -> Misfit | None:
    """Return which cameras are not those of the calibration; ``None`` if no difference is known."""
    if calibrated is None or connected is None or calibrated == connected:
        return None
    if calibrated == connected[::-1]:
        return Misfit(
            f"left and right camera swapped: calibrated with {calibrated[0]} on the left and {calibrated[1]} on the "
            "right, "
            f"connected the other way round",
            SIDES,
        )
    differences = [
        (side, before, now) for side, before, now in zip(SIDES, calibrated, connected, strict=True) if before != now
    ]
    reasons = [f"{side} camera exchanged: calibrated with serial {a}, connected {b}" for side, a, b in differences]
    return Misfit("; ".join(reasons), tuple(side for side, _, _ in differences))
