"""Cameras through the library Aravis: USB3 Vision, GigE Vision, and its own built-in camera.

Features and order of settings are those of ``drivers.camera``.
"""

from drivers.aravis.camera import AravisCamera

__all__ = ["AravisCamera"]
