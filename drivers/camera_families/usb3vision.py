"""Owns the family of cameras that keep to USB3 Vision and GenICam, whoever makes them (``drivers.camera``)."""

from __future__ import annotations

from contextlib import AbstractContextManager

from drivers.api import Camera, CameraSpec, Wires
from drivers.camera import UsbVisionCamera


def open_camera(spec: CameraSpec, wires: Wires) -> AbstractContextManager[Camera]:
    """The camera with that serial number on the wires' USB. Raises DeviceGone, DeviceRefused."""
    return UsbVisionCamera.open(spec, wires.usb_backend, wires.clock)
