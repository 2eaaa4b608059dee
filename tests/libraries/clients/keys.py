"""Tells every event of the key pad, and opens it again when it comes back. Argument: for how many seconds."""

from __future__ import annotations

import sys
import time

from drivers.api import DeviceError, DeviceGone, KeyPress, KeyRelease
from drivers.keys import HidKeypad, KeysSpec
from drivers.native import MonotonicClock, NativeWires
from tests.libraries.clients import say

SPEC = KeysSpec(0x1209, 0x4B46)


def tell(keys: HidKeypad, end: float) -> None:
    while time.monotonic() < end:
        match keys.next_event(0.1):
            case KeyPress(key):
                say(press=key.value)
            case KeyRelease(key, _, held_s):
                say(release=key.value, held_s=held_s)


if __name__ == "__main__":
    end = time.monotonic() + float(sys.argv[1])
    while time.monotonic() < end:
        try:
            with HidKeypad.open(SPEC, NativeWires().hidraw, MonotonicClock()) as keys:
                say(opened=keys.health().summary)
                tell(keys, end)
        except DeviceError as error:
            say(**{"gone" if isinstance(error, DeviceGone) else "failed": str(error)})
            time.sleep(0.2)
