"""Worlds for the device tests: small cameras, and one world per test."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from typing import Any

import pytest
import usb.core

from hw_sim.faults import FaultBook
from hw_sim.timing.world_time import WorldTime
from hw_sim.wires import SimWires
from hw_sim.wires import open as open_wires
from hw_sim.world import World, WorldOptions
from tests.hw_sim.devices.host import BoardHost, CardHost, GotFrame, Recorder, U3vHost, greys

SMALL: Mapping[str, Any] = {"width_px": 160, "height_px": 120, "truth": "nominal"}


class Bench:
    """A world, its wires, and hosts on them."""

    def __init__(self, name: str, options: dict[str, Any]) -> None:
        self._stack = ExitStack()
        self.name = name
        self.size = options["width_px"] * options["height_px"]
        self.world = self._stack.enter_context(World(WorldOptions(world=name, **options)))
        self.wires: SimWires = self._stack.enter_context(open_wires({"world": name}))
        self.board = BoardHost(f"kfsim://{name}/board")

    def camera(self, side: str = "left", trigger: bool = True, exposure_us: int = 8000) -> U3vHost:
        """A camera that waits for its trigger, its stream set up and its acquisition started."""
        camera = U3vHost(self.wires.usb_backend, f"KF-CAM-{side[0].upper()}")
        camera.put(0x200200, int(trigger))
        camera.put(0x200304, exposure_us)
        camera.set_up_stream()
        camera.put(0x200104, 1)
        return camera

    def projector(self) -> CardHost:
        """The projector in its mode, with grey 0 shown and full range."""
        card = CardHost(self.wires.open_card("/dev/dri/card0"), 11)
        card.set_property("Broadcast RGB", "Full")
        card.set_mode(card.buffer(greys([0])[0]))
        return card

    def recorder(self, patterns: int = 8, sides: tuple[str, ...] = ("left", "right")) -> Recorder:
        projector = self.projector()
        shades = [projector.buffer(g) for g in greys([40 + 200 * k // (patterns - 1) for k in range(patterns)])]
        return Recorder({side: self.camera(side) for side in sides}, self.board, projector, shades, self.size)

    def drain(self, camera: U3vHost) -> list[GotFrame]:
        frames = []
        while True:
            try:
                frames.append(camera.frame(100, self.size))
            except usb.core.USBTimeoutError:
                return frames

    def close(self) -> None:
        self._stack.close()


@pytest.fixture
def make_bench(request: pytest.FixtureRequest) -> Iterator[Callable[..., Bench]]:
    """Makes benches; closes them at the end, and then no thread may be left."""
    before = set(threading.enumerate())
    benches: list[Bench] = []

    def make(**options: Any) -> Bench:
        name = re.sub(r"\W+", "-", f"{request.node.name}-{len(benches)}").lower()
        benches.append(Bench(name, {**SMALL, **options}))
        return benches[-1]

    yield make
    for bench in benches:
        bench.close()
    left = [thread.name for thread in threading.enumerate() if thread not in before and thread.is_alive()]
    assert not left, f"threads outlive their world: {left}"


@pytest.fixture
def bench(make_bench: Callable[..., Bench]) -> Bench:
    return make_bench()


class HandTime(WorldTime):
    """World time that a test moves by hand."""

    def __init__(self) -> None:
        super().__init__(speed=0.0)

    def run(self, duration_s: float) -> None:
        """Let everything happen that is due within ``duration_s``."""
        with self.condition:
            until_ns = self.now_ns() + int(duration_s * 1e9)
            self.at(until_ns, lambda _: None)
            while self.due(until_ns) is not None:
                self.happen()


@pytest.fixture
def hand_time() -> HandTime:
    return HandTime()


@pytest.fixture
def faults(hand_time: HandTime) -> FaultBook:
    return FaultBook(hand_time.now_ns, hand_time.at, lambda _: None)
