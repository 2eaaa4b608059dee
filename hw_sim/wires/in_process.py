"""The in-process wires: ``[rig] wires = "hw_sim.wires:open"``."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import serial

from hw_sim import registry
from hw_sim.options import OptionError, WorldOptions, options_from
from hw_sim.people.chaos import ChaosDiver
from hw_sim.people.console import reading
from hw_sim.people.operator import Operator
from hw_sim.people.script import Diver, read_script
from hw_sim.timing.world_time import WorldClock
from hw_sim.window import open_windows
from hw_sim.wires.card_node import SimCardNode
from hw_sim.wires.hidraw import HidrawModule
from hw_sim.wires.pyusb_backend import UsbBackend
from hw_sim.world import World

SERIAL_PROTOCOLS = "hw_sim.wires"
"""Package in which pyserial finds ``protocol_kfsim``."""
CARD = "/dev/dri/card0"
SCRIPT_GRACE_S = 5.0


class ScriptFailedError(Exception):
    """The diver's script did not come to its end; the text has the failed step."""

    exit_code = 3


class SimWires:
    """Ends of the wires into one world, in the shape of ``docs/protocols/wires.md``."""

    def __init__(self, world: World) -> None:
        self._world = world
        self.usb_backend: Any = UsbBackend(list(world.cameras.values()), world.time)
        self.hidraw: Any = HidrawModule(world.keypad, world.time)
        self.clock = WorldClock(world.time)
        self.calendar = world.calendar

    def cards(self) -> tuple[str, ...]:
        """Paths of all cards: one, unless it is gone."""
        return (CARD,) if self._world.card.present else ()

    def open_card(self, path: str) -> SimCardNode:
        """Open the card. Raises FileNotFoundError for another path, and while it is gone."""
        if path != CARD or not self._world.card.present:
            raise FileNotFoundError(2, "No such file or directory", path)
        return SimCardNode(self._world.card, self._world.time)


@contextmanager
def open(options: Mapping[str, Any]) -> Iterator[SimWires]:
    """Open wires into the world of ``options``; unless it exists already it is made, and ends with them.

    Raises OptionError, ScriptError, WindowError; at the end ScriptFailedError when a script was given and did not
    succeed, WindowError when the windows failed.
    """
    world_options = options_from(options)
    with ExitStack() as stack:
        world = registry.find(world_options.world)
        if world is None:
            world = stack.enter_context(World(world_options))
        stack.enter_context(_serial_protocol())
        if world_options.window:
            stack.enter_context(open_windows(world))
        if world_options.console:
            stack.enter_context(reading(world, _status(world_options, "a console"), sys.stdin.fileno()))
        diver = _diver(world_options, world)
        if diver is not None:
            stack.enter_context(_acting(diver))
        yield SimWires(world)


def _diver(world_options: WorldOptions, world: World) -> Operator | None:
    """Return the diver that operates the instrument; ``None`` without one."""
    if world_options.script is None and not world_options.chaos:
        return None
    status = _status(world_options, "a diver")
    if world_options.script is not None:
        return Diver(world, read_script(Path(world_options.script)), status)
    chaos = world_options.chaos
    return ChaosDiver(world, status, int(chaos["seed"]), int(chaos["scans"]), Path(chaos["report"]))


def _status(world_options: WorldOptions, who: str) -> Path:
    if world_options.status is None:
        raise OptionError(f"{who} needs the option status: the path of the service's status file")
    return Path(world_options.status)


@contextmanager
def _acting(diver: Operator) -> Iterator[None]:
    diver.start()
    try:
        yield
    finally:
        diver.stop(SCRIPT_GRACE_S)
    if diver.failure is not None:
        raise ScriptFailedError(diver.failure)
    if not diver.finished:
        raise ScriptFailedError("the service ended before the script did")


@contextmanager
def _serial_protocol() -> Iterator[None]:
    """Register ``kfsim://`` with pyserial as long as the wires are open; several may be open at once."""
    packages: list[str] = serial.protocol_handler_packages
    packages.append(SERIAL_PROTOCOLS)
    try:
        yield
    finally:
        packages.remove(SERIAL_PROTOCOLS)
