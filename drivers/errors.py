"""Owns the errors of devices: part of the contract (``drivers.api``), and all of it that a reader of rig files needs."""

from __future__ import annotations


class DeviceError(Exception):
    """A device failed. ``device`` names it as in the rig file (``camera.left``), ``remedy`` says what to do."""

    def __init__(self, device: str, message: str, remedy: str) -> None:
        super().__init__(f"{device}: {message}. {remedy}")
        self.device = device
        self.message = message
        self.remedy = remedy


class DeviceGone(DeviceError):
    """The device was unplugged or no longer answers; reopening it may help."""


class CardGone(DeviceGone):
    """The whole graphics card, not only an output, no longer answers: its node must be opened anew, and whatever was
    drawn on it with GL is lost with it."""


class DeviceRefused(DeviceError):
    """The device works but refused the request (wrong value, busy, wrong state)."""
