"""The family of cameras of the library Aravis: USB3 Vision, GigE Vision, and its built-in one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager

from drivers.api import Camera, CameraSpec, Wires
from drivers.aravis import AravisCamera
from drivers.aravis.camera import listed_cameras
from drivers.aravis.library import library


def open_camera(spec: CameraSpec, wires: Wires) -> AbstractContextManager[Camera]:
    """Open the camera with that serial number on any of this machine's interfaces.

    The library does not use the wires' USB. Raises DeviceGone, DeviceRefused.
    """
    return AravisCamera.open(spec, wires.clock)


def list_cameras(wires: Wires) -> Iterator[str]:
    """Yield every camera on this machine's interfaces that the library sees, but not its built-in one.

    Raises DeviceRefused where the library is not installed.
    """
    return listed_cameras(library("cameras"))
