"""The test bed: a world's devices as nodes of ``/dev`` and ``/sys``, for programs under umockdev.

The programs run with umockdev's preload library. Devices that leave the world's buses leave the test bed, and those
that come back appear anew, as with udev.
"""

from __future__ import annotations

import shutil
import tempfile
import threading
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from hw_sim.devices import keypad as pad
from hw_sim.devices.u3v_camera import U3vCamera
from hw_sim.timing.world_time import LONGEST_WAIT_S
from hw_sim.wires.umockdev import hidraw_node, plugs
from hw_sim.wires.umockdev.dri import CardMemory, DrmFile, HostClock
from hw_sim.wires.umockdev.preload import OTHER_NODES, NodeServer, Plain
from hw_sim.wires.umockdev.readiness import Readiness
from hw_sim.wires.umockdev.tree import SysDevice, Tree
from hw_sim.wires.umockdev.tty import BoardLine
from hw_sim.wires.umockdev.usbfs import Tap, UsbDevice, UsbFile
from hw_sim.world import World

PRELOAD = "libumockdev-preload.so.0"


@dataclass(slots=True)
class _PluggedDevice:
    """A device that is in the test bed now."""

    enumeration: int
    devices: list[SysDevice]
    """Parents first."""
    server: NodeServer
    ready: Readiness


class Testbed:
    """A context manager; end the programs that use it before it ends. ``tap`` gets every URB, lock held."""

    __test__ = False

    def __init__(self, world: World, tap: Tap | None = None) -> None:
        self._world, self._tap = world, tap
        self._plugged: dict[str, _PluggedDevice] = {}
        self._addresses = 1
        self._ending = False
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            # Not pytest's folder: a socket's path is short.
            self.root = Path(tempfile.mkdtemp(prefix="kf-dev."))
            stack.callback(shutil.rmtree, self.root, ignore_errors=True)
            self._tree = Tree(self.root)
            for device in plugs.FIXED:
                self._tree.add(device)
            stack.callback(NodeServer(self.root, OTHER_NODES, Plain).close)
            stack.callback(self._pull_all)
            line = BoardLine(self._tree.node(plugs.BOARD.node or ""), self._world.board, self._world.time)
            stack.callback(line.close)
            self._tree.add(plugs.BOARD)
            self._tree.node(plugs.BOARD_LINK).symlink_to(plugs.BOARD.node or "")
            memory = stack.enter_context(CardMemory(self._tree.node(plugs.CARD.node or "")))
            clock = HostClock(self._world.time, lambda: self._world.recording)
            card = NodeServer(
                self.root,
                plugs.CARD.node or "",
                lambda: DrmFile(self._world.card, self._world.time, memory, clock),
            )
            stack.callback(card.close)
            self._tree.add(plugs.CARD)
            self._look()
            thread = threading.Thread(target=self._watch, name="plugs", daemon=True)
            thread.start()
            stack.callback(thread.join, 5.0)
            stack.callback(self._end)
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    @property
    def environment(self) -> dict[str, str]:
        """The variables to add to a program's environment."""
        return {"LD_PRELOAD": PRELOAD, "UMOCKDEV_DIR": str(self.root)}

    # ------------------------------------------------------------------------------------------ coming and going

    def _end(self) -> None:
        with self._world.time.condition:
            self._ending = True
            self._world.time.condition.notify_all()

    def _watch(self) -> None:
        while True:
            with self._world.time.condition:
                if self._ending:
                    return
                if not self._stale():
                    self._world.time.condition.wait(LONGEST_WAIT_S)
                    continue
            self._look()

    def _expected(self) -> dict[str, int]:
        """Return the devices on a bus, by name, with their enumeration. The caller holds the lock."""
        world = self._world
        expected = {camera.name: camera.enumeration for camera in world.cameras.values() if camera.plugged}
        if world.keypad.plugged:
            expected["keypad"] = world.keypad.enumeration
        return expected

    def _stale(self) -> bool:
        return self._expected() != {name: plugged.enumeration for name, plugged in self._plugged.items()}

    def _look(self) -> None:
        with self._world.time.condition:
            expected = self._expected()
        for name in [n for n, p in self._plugged.items() if expected.get(n) != p.enumeration]:
            self._pull(name)
        for name, enumeration in expected.items():
            if name not in self._plugged:
                camera = next((c for c in self._world.cameras.values() if c.name == name), None)
                plugged = self._plug_keypad(enumeration) if camera is None else self._plug_camera(camera, enumeration)
                self._plugged[name] = plugged

    def _plug_camera(self, camera: U3vCamera, enumeration: int) -> _PluggedDevice:
        self._addresses += 1
        port = 1 + list(self._world.cameras.values()).index(camera)
        device = plugs.camera(camera, port, self._addresses)
        node = device.node or ""
        # usbfs reports finished transfers as POLLOUT, hidraw its reports as POLLIN.
        ready = Readiness(self._tree.node(node), for_writing=True)
        bus = plugs.bus_of(camera)
        shared = UsbDevice(camera, self._world.time, ready, bus, self._addresses, self._tap)
        shared.enumeration = enumeration
        server = NodeServer(self.root, node, lambda: UsbFile(shared))
        self._tree.add(device)
        return _PluggedDevice(enumeration, [device], server, ready)

    def _plug_keypad(self, enumeration: int) -> _PluggedDevice:
        self._addresses += 1
        devices = plugs.keypad(pad, enumeration, self._addresses)
        node = devices[-1].node or ""
        ready = Readiness(self._tree.node(node))
        shared = hidraw_node.PluggedPad(self._world.keypad, self._world.time, ready)
        shared.enumeration = enumeration
        server = NodeServer(self.root, node, lambda: hidraw_node.HidFile(shared))
        for device in devices:
            self._tree.add(device)
        return _PluggedDevice(enumeration, devices, server, ready)

    def _pull(self, name: str) -> None:
        plugged = self._plugged.pop(name)
        plugged.server.close()
        plugged.ready.close()
        for device in reversed(plugged.devices):
            self._tree.remove(device)

    def _pull_all(self) -> None:
        for name in list(self._plugged):
            self._pull(name)
