"""The board's start: MicroPython runs this file after each reset, and it does not return.

A jumper from SERVICE to ground keeps it from starting; then MicroPython's prompt is on the USB port, as on a bare
module.
"""

import gc
import sys

import machine

from drivers.board.firmware import pins
from drivers.board.firmware.chip import ChipHardware, chip_name, reset_cause
from drivers.board.firmware.core import BoardCore

COLLECT_EVERY = 64
"""Turns of the loop between two collections: a small heap swept often pauses for a few ms, a full one for longer."""


def run() -> None:
    """Run the trigger board until power-off."""
    if not machine.Pin(pins.gpio("SERVICE"), machine.Pin.IN, machine.Pin.PULL_UP).value():
        return
    name = chip_name(sys.implementation._machine)
    cause = reset_cause(name)
    serial = "KF-BRD-" + machine.unique_id().hex().upper()[-8:]
    hardware = ChipHardware(name, serial)
    core = BoardCore(hardware, serial, cause)
    turn_count = 0
    while True:
        core.step()
        hardware.pump()
        turn_count += 1
        if turn_count % COLLECT_EVERY == 0:
            gc.collect()


if __name__ == "__main__":
    run()
