"""USB3 Vision cameras: discovery, control, features by SFNC name, and the image stream."""

from drivers.camera.camera import UsbVisionCamera
from drivers.camera.spec import CameraSpec

__all__ = ["CameraSpec", "UsbVisionCamera"]
