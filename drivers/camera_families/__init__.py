"""The families of cameras: each module of this package is one, named by ``kind`` of ``[camera]``.

Such a module has a function ``open_camera(spec, wires)`` that finds, opens and identifies one camera, and returns it as
a context manager that gives a ``drivers.api.Camera``. It raises DeviceGone (not there) and DeviceRefused (not usable).
If it has a function ``list_cameras(wires)`` besides, that yields a line of words for each camera it sees, whatever the
rig file has. It is imported when a rig file names it; a name that is no module of this package is never imported
(``docs/adr/0036-a-camera-family-is-a-module.md``).
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Protocol

from drivers.errors import DeviceRefused

if TYPE_CHECKING:  # the rig file's check needs the names alone
    from drivers.api import Camera, CameraSpec, Wires

USUAL = "usb3vision"
"""Family of a rig file that names none."""


class OpenCamera(Protocol):
    """Function that a family's module must offer."""

    def __call__(self, spec: CameraSpec, wires: Wires) -> AbstractContextManager[Camera]: ...


class ListCameras(Protocol):
    """Function that a family's module may offer: a line with serial number and address for each camera.

    Raises DeviceError.
    """

    def __call__(self, wires: Wires) -> Iterator[str]: ...


def families() -> tuple[str, ...]:
    """Return the names that ``kind`` may have."""
    return tuple(sorted(module.name for module in pkgutil.iter_modules(__path__) if not module.name.startswith("_")))


def opener(kind: str) -> OpenCamera:
    """Return the function that opens cameras of a family. Raises DeviceRefused for an unknown family."""
    if kind not in families():
        raise DeviceRefused(
            "camera",
            f"there is no family {kind!r}; allowed: {', '.join(families())}",
            f'Correct kind of [camera]; usually it is "{USUAL}"',
        )
    function: OpenCamera = importlib.import_module(f"{__name__}.{kind}").open_camera
    return function


def lister(kind: str) -> ListCameras | None:
    """Return the function that lists cameras of a family; ``None`` if the family has none or is unknown."""
    if kind not in families():
        return None
    function: ListCameras | None = getattr(importlib.import_module(f"{__name__}.{kind}"), "list_cameras", None)
    return function
