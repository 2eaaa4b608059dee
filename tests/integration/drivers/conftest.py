"""A simulated world of its own for each test, entered by both doors: the wires and the back door."""

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
from drivers.output.outputs import Outputs
from drivers.rig import (
    BoardSpec,
    CameraSpec,
    KeysSpec,
    OutputKind,
    OutputSpec,
    open_board,
    open_keys,
    open_outputs,
    open_wires,
)
from hw_sim.world import World, WorldOptions

WIDTH, HEIGHT = 400, 300
SETTINGS = CameraSettings(WIDTH, HEIGHT, 8000.0, 0.0)
SERIALS = {"left": "KF-CAM-L", "right": "KF-CAM-R"}


@dataclass
class Rig:
    """One world, and the devices a test opens in it; everything closes at the end."""

    name: str
    world: Any
    wires: Wires
    stack: ExitStack

    def camera(self, side: str = "left") -> UsbVisionCamera:
        """An opened, configured camera."""
        camera = self.stack.enter_context(
            UsbVisionCamera.open(CameraSpec(f"camera.{side}", SERIALS[side]), self.wires.usb_backend, self.wires.clock)
        )
        camera.configure(SETTINGS)
        return camera

    def board(self) -> TriggerBoard:
        """An opened board that has seen a vertical sync."""
        board = self.stack.enter_context(open_board(BoardSpec(f"kfsim://{self.name}/board"), self.wires))
        self.wires.clock.sleep_s(0.05)
        return board

    def keys(self) -> HidKeypad:
        return self.stack.enter_context(open_keys(KeysSpec(0x1209, 0x4B46), self.wires))

    def outputs(self) -> Outputs:
        card = "/dev/dri/card0"
        projector = OutputSpec(OutputKind.KMS, card, "HDMI-A-1", 1024, 768, 60.0)
        display = OutputSpec(OutputKind.KMS, card, "DP-1", 800, 480, 60.0)
        return self.stack.enter_context(open_outputs(projector, display, self.wires))


@pytest.fixture
def rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    """A world whose idle seconds take a real second each, or a ``param``-th of it."""
    idle_speed = float(getattr(request, "param", 1.0))
    name = request.node.name.replace("[", "-").replace("]", "").replace(" ", "-")
    with (
        World(
            WorldOptions(world=name, width_px=WIDTH, height_px=HEIGHT, seed=1, noise=False, idle_speed=idle_speed)
        ) as world,
        open_wires("hw_sim.wires:open", {"world": name}) as wires,
        ExitStack() as stack,
    ):
        yield Rig(name, world, wires, stack)
