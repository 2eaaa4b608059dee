"""Cameras through the library Aravis: USB3 Vision, GigE Vision, and the camera that the library brings. Features and order of settings are ``drivers.camera``'s."""

from drivers.aravis.camera import AravisCamera

__all__ = ["AravisCamera"]
