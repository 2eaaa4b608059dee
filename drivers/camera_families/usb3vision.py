"""Owns the family of cameras that keep to USB3 Vision and GenICam, whoever makes them (``drivers.camera``)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager

from drivers.api import Camera, CameraSpec, Wires
from drivers.camera import UsbVisionCamera
from drivers.camera.usb import default_backend, find_cameras


def open_camera(spec: CameraSpec, wires: Wires) -> AbstractContextManager[Camera]:
    """The camera with that serial number on the wires' USB. Raises DeviceGone, DeviceRefused."""
    return UsbVisionCamera.open(spec, wires.usb_backend, wires.clock)


def list_cameras(wires: Wires) -> Iterator[str]:
    """Every camera on the wires' USB. Raises DeviceError, usb.core.USBError."""
    for camera in find_cameras(wires.usb_backend or default_backend()):
        speed = "" if camera.link_speed_mbps is None else f", {camera.link_speed_mbps} Mbit/s"
        # Without a number it is permission, or another program: just what whoever reads this wants to know.
        serial_number = camera.serial or f"serial number not readable ({camera.unreadable or 'none'})"
        yield f"{serial_number} (USB3 Vision, {camera.location}{speed})"
