"""The keypad's start: MicroPython runs this file after each reset, and it does not return.

A jumper from SERVICE to ground keeps it from starting; then MicroPython's prompt is on the USB port, as on a bare
module.
"""

import gc

import machine

from drivers.keys.firmware import pins
from drivers.keys.firmware.chip import ChipPad
from drivers.keys.firmware.core import PadCore

COLLECT_EVERY = 256
"""Turns of the loop between two collections of memory."""


def run() -> None:
    """Run the keypad until power-off."""
    if not machine.Pin(pins.gpio("SERVICE"), machine.Pin.IN, machine.Pin.PULL_UP).value():
        return
    core = PadCore(ChipPad("KF-KEY-" + machine.unique_id().hex().upper()[-8:]))
    turn_count = 0
    while True:
        core.step()
        turn_count += 1
        if turn_count % COLLECT_EVERY == 0:
            gc.collect()


if __name__ == "__main__":
    run()
