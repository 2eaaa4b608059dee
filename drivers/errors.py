"""The errors of devices: the part of the contract (``drivers.api``) that a reader of rig files needs."""

from __future__ import annotations


class DeviceError(Exception):
    """A device failed. ``device`` names it as in the rig file (``camera.left``)."""

    def __init__(self, device: str, message: str, remedy: str) -> None:
        super().__init__(f"{device}: {message}. {remedy}")
        self.device = device
        self.message = message
        self.remedy = remedy


class DeviceGone(DeviceError):
    """The device was unplugged or no longer answers; reopening it may help."""


class CardGone(DeviceGone):
    """The whole graphics card, not only an output, no longer answers.

    Its node must be opened again, and all GL content on it is lost.
    """


class DeviceRefused(DeviceError):
    """The device works but refused the request (wrong value, busy, wrong state)."""
