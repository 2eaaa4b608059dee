"""One simulated world for all tests of a file, entered by both doors: the wires and the back door."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import pytest

from drivers.api import CameraSettings, Wires
from drivers.board import TriggerBoard
from drivers.camera import UsbVisionCamera
from drivers.keys import HidKeypad
from drivers.rig import BoardSpec, CameraSpec, KeysSpec, open_board, open_keys, open_wires
from hw_sim.world import World, WorldOptions

WIDTH, HEIGHT = 160, 120
SETTINGS = CameraSettings(WIDTH, HEIGHT, 8000.0, 0.0)
SERIALS = {"left": "KF-CAM-L", "right": "KF-CAM-R"}


@dataclass
class Rig:
    """The world, and the devices a test opens in it; everything closes and is whole again at its end."""

    name: str
    world: Any
    wires: Wires
    stack: ExitStack

    def camera(self, side: str = "left") -> UsbVisionCamera:
        """Return an opened, configured camera."""
        camera = self.stack.enter_context(
            UsbVisionCamera.open(CameraSpec(f"camera.{side}", SERIALS[side]), self.wires.usb_backend, self.wires.clock)
        )
        camera.configure(SETTINGS)
        return camera

    def board(self) -> TriggerBoard:
        """Return an opened board that has seen a vertical sync."""
        board = self.stack.enter_context(open_board(BoardSpec(f"kfsim://{self.name}/board"), self.wires))
        self.wires.clock.sleep_s(0.05)
        return board

    def keys(self) -> HidKeypad:
        return self.stack.enter_context(open_keys(KeysSpec(0x1209, 0x4B46), self.wires))


@pytest.fixture(scope="module")
def whole_rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    """A world whose idle seconds take a quarter of one."""
    name = request.module.__name__.rpartition(".")[2]
    options = WorldOptions(world=name, width_px=WIDTH, height_px=HEIGHT, seed=1, noise=False, idle_speed=4.0)
    with World(options) as world, open_wires("hw_sim.wires:open", {"world": name}) as wires:
        yield Rig(name, world, wires, ExitStack())


@pytest.fixture
def rig(whole_rig: Rig) -> Iterator[Rig]:
    with whole_rig.stack:
        yield whole_rig
    whole_rig.world.clear_faults()
