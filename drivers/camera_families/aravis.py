"""Owns the family of cameras that the library Aravis knows: USB3 Vision, GigE Vision, and the one that it brings (``drivers.aravis``)."""

from __future__ import annotations

from contextlib import AbstractContextManager

from drivers.api import Camera, CameraSpec, Wires
from drivers.aravis import AravisCamera


def open_camera(spec: CameraSpec, wires: Wires) -> AbstractContextManager[Camera]:
    """The camera with that serial number on any of this machine's interfaces: the library finds its own way, past the wires' USB. Raises
    DeviceGone, DeviceRefused."""
    return AravisCamera.open(spec, wires.clock)
