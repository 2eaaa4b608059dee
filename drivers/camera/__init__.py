"""USB3 Vision cameras: discovery, control, features by SFNC name, and the image stream."""

from drivers.api import CameraSpec
from drivers.camera.camera import UsbVisionCamera

__all__ = ["CameraSpec", "UsbVisionCamera"]
