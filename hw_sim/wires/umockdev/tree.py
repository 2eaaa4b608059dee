"""The files in place of ``/sys`` and ``/dev``: the present devices, and messages about them."""

from __future__ import annotations

import itertools
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from hw_sim.wires.umockdev import uevent

BUSES = ("usb", "hid", "pci")


@dataclass(frozen=True, slots=True)
class SysDevice:
    """A device in sysfs. ``path`` begins with ``devices/``; ``node`` lies below ``/dev``."""

    path: str
    subsystem: str
    node: str | None = None
    number: tuple[int, int] | None = None
    """Major and minor number."""
    kind: str | None = None
    """DEVTYPE."""
    attributes: Mapping[str, str | bytes] = field(default_factory=dict)
    links: Mapping[str, str] = field(default_factory=dict)
    properties: Mapping[str, str] = field(default_factory=dict)

    def all_properties(self, dev: str = "/dev/") -> dict[str, str]:
        """Return the properties as in udev; the kernel's own ``uevent`` file has the node without ``/dev/``."""
        properties = {"SUBSYSTEM": self.subsystem}
        if self.kind is not None:
            properties["DEVTYPE"] = self.kind
        if self.node is not None:
            properties["DEVNAME"] = f"{dev}{self.node}"
        if self.number is not None:
            properties["MAJOR"], properties["MINOR"] = map(str, self.number)
        return {**properties, **self.properties}


class Tree:
    """``/sys`` and ``/dev`` below ``root``."""

    def __init__(self, root: Path) -> None:
        self.root = root
        for part in ("sys/bus", "sys/class", "sys/devices", "dev/.node", "ioctl"):
            (root / part).mkdir(parents=True)
        self._messages = itertools.count(1)

    def node(self, name: str) -> Path:
        """Return the path of the file for ``/dev/<name>``."""
        return self.root / "dev" / name

    def add(self, device: SysDevice) -> None:
        """Add a device and notify all listeners. Its node is made before, by its server."""
        place = self.root / "sys" / device.path
        place.mkdir(parents=True, exist_ok=True)
        below = "../" * (len(Path(device.path).parts))
        group = ("bus" if device.subsystem in BUSES else "class", device.subsystem)
        (place / "subsystem").symlink_to(below + "/".join(group))
        for name, value in device.attributes.items():
            (place / name).write_bytes(value if isinstance(value, bytes) else f"{value}\n".encode())
        for name, target in device.links.items():
            (place / name).symlink_to(target)
        lines = "".join(f"{key}={value}\n" for key, value in device.all_properties(dev="").items())
        (place / "uevent").write_text(lines, encoding="ascii")
        self._list(device, group, place)
        self._tell("add", device)

    def _list(self, device: SysDevice, group: tuple[str, str], place: Path) -> None:
        for link in self._lists(device, group):
            link.parent.mkdir(parents=True, exist_ok=True)
            link.symlink_to(os.path.relpath(place, link.parent))
        if device.node is not None and device.number is not None:
            self._number(device.node).symlink_to("{}:{}".format(*device.number))

    def _lists(self, device: SysDevice, group: tuple[str, str]) -> list[Path]:
        sys = self.root / "sys"
        name = Path(device.path).name
        listed = [sys.joinpath(*group, *(("devices",) if group[0] == "bus" else ()), name)]
        if device.number is not None:
            listed.append(sys / "dev" / "char" / "{}:{}".format(*device.number))
        return listed

    def _number(self, node: str) -> Path:
        """Return the path of a node's numbers for the preload library."""
        return self.root / "dev" / ".node" / node.replace("/", "_")

    def remove(self, device: SysDevice) -> None:
        """Remove a device with its node and all below it, and notify all listeners."""
        group = ("bus" if device.subsystem in BUSES else "class", device.subsystem)
        for link in self._lists(device, group):
            link.unlink(missing_ok=True)
        if device.node is not None:
            self._number(device.node).unlink(missing_ok=True)
            self.node(device.node).unlink(missing_ok=True)
        shutil.rmtree(self.root / "sys" / device.path, ignore_errors=True)
        self._tell("remove", device)

    def _tell(self, action: str, device: SysDevice) -> None:
        properties = device.all_properties()
        uevent.tell(self.root, uevent.message(action, device.path, next(self._messages), properties))
