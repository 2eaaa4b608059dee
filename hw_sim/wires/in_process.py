"""Owns the in-process wires: what ``[rig] wires = "hw_sim.wires:open"`` resolves to."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import serial

from hw_sim import registry
from hw_sim.options import OptionError, options_from
from hw_sim.pace import WorldClock
from hw_sim.script import Diver, parse_script
from hw_sim.wires.card import SimCardNode
from hw_sim.wires.hidraw import HidrawModule
from hw_sim.wires.pyusb_backend import UsbBackend
from hw_sim.world import World

SERIAL_PROTOCOLS = "hw_sim.wires"
SCRIPT_END_TIMEOUT_S = 5.0


class ScriptFailedError(Exception):
    """The diver's script did not come to its end; the text says at which step."""


class SimWires:
    """Ends of the wires into one world, in the shape the product asks for (``docs/protocols/wires.md``)."""

    def __init__(self, world: World) -> None:
        self._world = world
        self.usb_backend: Any = UsbBackend(list(world.cameras.values()), world.time)
        self.hidraw: Any = HidrawModule(world.keypad, world.time)
        self.clock = WorldClock(world.time)

    def open_card(self, path: str) -> SimCardNode:
        """The simulated card is there under any path."""
        return SimCardNode(self._world.card, self._world.time)


@contextmanager
def open(options: Mapping[str, Any]) -> Iterator[SimWires]:
    """Wires into the world that ``options`` name; it is made, and ends with them, unless it exists already.

    Raises OptionError, ScriptError; at the end ScriptFailedError when a script was given and failed.
    """
    wanted = options_from(options)
    steps = parse_script(Path(wanted.script).read_text(encoding="utf-8")) if wanted.script is not None else ()
    if steps and wanted.status is None:
        raise OptionError("a script needs the option status: the path of the service's status file")
    with ExitStack() as stack:
        world = registry.find(wanted.world)
        if world is None:
            world = stack.enter_context(World(wanted))
        stack.enter_context(_serial_protocol())
        diver = Diver(world, steps, Path(wanted.status or "")) if steps else None
        if diver is not None:
            diver.start()
        yield SimWires(world)
        if diver is not None:
            diver.join(SCRIPT_END_TIMEOUT_S)
            if diver.error is not None:
                raise ScriptFailedError(str(diver.error)) from diver.error
            if diver.running:
                raise ScriptFailedError("the service ended before the script did")


@contextmanager
def _serial_protocol() -> Iterator[None]:
    """pyserial knows ``kfsim://`` as long as the wires are open; several may be open at once."""
    packages: list[str] = serial.protocol_handler_packages
    packages.append(SERIAL_PROTOCOLS)
    try:
        yield
    finally:
        packages.remove(SERIAL_PROTOCOLS)
