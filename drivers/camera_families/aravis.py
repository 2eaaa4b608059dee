"""Owns the family of cameras that the library Aravis knows: USB3 Vision, GigE Vision, and the one that it brings (``drivers.aravis``)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager

from drivers.api import Camera, CameraSpec, Wires
from drivers.aravis import AravisCamera
from drivers.aravis.camera import listed_cameras
from drivers.aravis.library import library


def open_camera(spec: CameraSpec, wires: Wires) -> AbstractContextManager[Camera]:
    """The camera with that serial number on any of this machine's interfaces: the library finds its own way, past the wires' USB. Raises
    DeviceGone, DeviceRefused."""
    return AravisCamera.open(spec, wires.clock)


def list_cameras(wires: Wires) -> Iterator[str]:
    """Every camera that the library sees on this machine's interfaces, without the one that it brings. Raises DeviceRefused where the library is not
    installed."""
    return listed_cameras(library("cameras"))
