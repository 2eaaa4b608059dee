"""Owns whether a calibration is of an instrument: of its serial number, of its cameras, of their image size.

A calibration describes two lenses behind two windows. With another camera in the housing it describes something that is
not there any more, and lengths are wrong by percents while every picture looks right.
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
    """Serial numbers of the left and the right camera; ``None``: not known."""


@dataclass(frozen=True, slots=True)
class Misfit:
    """Reason why a calibration is not of an instrument."""

    reason: str
    exchanged: tuple[str, ...] = ()
    """Sides (``left``, ``right`` or both) whose cameras were exchanged, where nothing else is another."""


def owner_misfit(calibration: Calibration, owner: Owner) -> Misfit | None:
    """Return why ``calibration`` is not of ``owner``; ``None`` where it is, as far as is known."""
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
    """Return which cameras are not those of the calibration; ``None``: they are, or nobody knows."""
    if calibrated is None or connected is None or calibrated == connected:
        return None
    if calibrated == connected[::-1]:
        return Misfit(
            f"left and right camera swapped: calibrated with {calibrated[0]} on the left and {calibrated[1]} on the "
            "right, "
            f"connected the other way round",
            SIDES,
        )
    others = [
        (side, before, now) for side, before, now in zip(SIDES, calibrated, connected, strict=True) if before != now
    ]
    reasons = [f"{side} camera exchanged: calibrated with serial {a}, connected {b}" for side, a, b in others]
    return Misfit("; ".join(reasons), tuple(side for side, _, _ in others))
