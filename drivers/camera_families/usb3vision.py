"""The family of all cameras with USB3 Vision and GenICam (``drivers.camera``)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager

from drivers.api import Camera, CameraSpec, Wires
from drivers.camera import UsbVisionCamera
from drivers.camera.usb import default_backend, find_cameras


def open_camera(spec: CameraSpec, wires: Wires) -> AbstractContextManager[Camera]:
    """Open the camera with that serial number on the wires' USB. Raises DeviceGone, DeviceRefused."""
    return UsbVisionCamera.open(spec, wires.usb_backend, wires.clock)


def list_cameras(wires: Wires) -> Iterator[str]:
    """Yield a line for every camera on the wires' USB. Raises DeviceError, usb.core.USBError."""
    for camera in find_cameras(wires.usb_backend or default_backend()):
        speed = "" if camera.link_speed_mbps is None else f", {camera.link_speed_mbps} Mbit/s"
        # A missing number means no permission, or another program: the reader of this line needs that.
        serial_number = camera.serial or f"serial number not readable ({camera.unreadable or 'none'})"
        yield f"{serial_number} (USB3 Vision, {camera.location}{speed})"
