"""The firmware files for a trigger board and a keypad, with the values that the rig file sets in them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import drivers
from appliance.store import ProjectorRig, Rig
from appliance.workshop.finding import BringupError

Part = Literal["board", "keys"]

LIBRARIES: Mapping[Part, str] = {"board": "usb-device-cdc@0.1.2", "keys": "usb-device-hid@0.2.0"}
"""Library of micropython-lib that each firmware needs, in the version of its manifest there."""
INSTRUMENT = "instrument.py"
START = "main.py"

NEGATIVE, POSITIVE = False, True
SYNCS: Mapping[tuple[int, int, int], bool] = {
    (640, 480, 60): NEGATIVE,
    (800, 600, 60): POSITIVE,
    (848, 480, 60): POSITIVE,
    (1024, 768, 60): NEGATIVE,
    (1024, 768, 70): NEGATIVE,
    (1024, 768, 75): POSITIVE,
    (1280, 720, 50): POSITIVE,
    (1280, 720, 60): POSITIVE,
    (1280, 960, 60): POSITIVE,
    (1280, 1024, 60): POSITIVE,
}
"""Sign of the vertical sync by width, height and rate of a mode, where all published timings (VESA DMT 1.13, CTA-861)
have the same. For 1280x800, 1920x1080 and 1920x1200 they do not: reduced blanking, or the other standard, has the other
sign."""


def sync_rises(projector: ProjectorRig) -> bool:
    """Return True if the sync at the board's pin begins with a rising edge.

    Raises BringupError where neither the rig file nor the published timings say so.
    """
    if projector.sync is not None:
        return projector.sync == "positive"
    mode = (projector.width_px, projector.height_px, round(projector.refresh_hz))
    rises = SYNCS.get(mode)
    if rises is None:
        # A wrong guess would shift every trigger by the width of the sync, which no check would notice.
        raise BringupError(
            f"projector: {mode[0]}x{mode[1]} at {mode[2]} Hz may have either sign of the vertical sync; "
            'allowed: sync = "negative" or "positive" under [projector]; take it from the mode (docs/build/firmware.md)'
        )
    return rises


def instrument_values(part: Part, rig: Rig) -> dict[str, int | bool]:
    """Return the values of the firmware's ``instrument.py``, by name. Raises BringupError."""
    owner = rig.board if part == "board" else rig.keys
    values: dict[str, int | bool] = {"VENDOR": owner.vendor_id, "PRODUCT": owner.product_id}
    if part == "board":
        values["SYNC_RISES"] = sync_rises(rig.projector)
    return values


def firmware_files(part: Part, rig: Rig) -> dict[str, bytes]:
    """Return every file of one firmware by its path on the microcontroller. Raises BringupError."""
    folder = Path(drivers.__file__).parent / part / "firmware"
    sources = sorted(folder.glob("*.py"))
    if not sources:
        raise BringupError(
            f"{folder}: the firmware's sources are not part of an installation; "
            f"run it in the source tree: ./dev run kingfisher setup firmware {part}"
        )
    files: dict[str, bytes] = {}
    for source in sources:
        content = source.read_bytes()
        if source.name == INSTRUMENT:
            content = _with_values(content.decode(), instrument_values(part, rig)).encode()
        # MicroPython starts the main.py at the root, and the modules import each other by their names here.
        files[START if source.name == START else f"drivers/{part}/firmware/{source.name}"] = content
    return files


def commands(part: Part, folder: Path) -> tuple[str, ...]:
    """Return the shell commands that copy ``folder`` onto a module with MicroPython; each may be repeated."""
    return (
        f"./dev run mpremote mip install {LIBRARIES[part]}",
        f"./dev run mpremote cp -r {folder}/drivers :",
        # Last: a module that was unplugged before has no start file, and shows its prompt.
        f"./dev run mpremote cp {folder}/{START} :{START}",
    )


def _with_values(text: str, values: Mapping[str, int | bool]) -> str:
    for name, value in values.items():
        spelt = str(value) if isinstance(value, bool) else f"0x{value:04X}"
        text, count = re.subn(rf"^{name} = .*$", f"{name} = {spelt}", text, flags=re.MULTILINE)
        if count != 1:
            raise BringupError(f"{INSTRUMENT} has {count} lines '{name} = …' instead of one: restore the file")
    return text
