"""Owns what the rig file may say about finding a camera."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CameraSpec:
    """One camera of the rig.

    ``name`` is the rig's name for it (``camera.left``) and appears in every error. ``serial`` is the serial number
    the camera itself reports. ``trigger_source`` is the SFNC name of the input that the board's trigger line is
    wired to; ``None`` takes the first ``Line…`` the camera offers.
    """

    name: str
    serial: str
    trigger_source: str | None = None
