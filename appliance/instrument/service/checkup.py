"""Owns what ``kingfisher check`` finds: each device as it identifies itself, and what the rig file wants otherwise."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from appliance.instrument.service.devices import Devices
from appliance.store import Rig, holder
from drivers import rig as drivers_rig
from drivers.api import DeviceError, DeviceRefused, Health, Projector, Wires
from drivers.inventory import BusInventory, list_buses

THERE, NOTHING = "there", "nothing"
"""Name in a device's details of what its bus has, and what it says where that is nothing."""


def check(rig: Rig) -> list[Health]:
    """Open every device once, one after the other, through the shipped drivers, and collect what each says about
    itself.

    A device that is missing, refused, or not what the rig file states is not ``ok``; its summary says why, and what to
    do. Raises DeviceError where the wires themselves cannot be had, or the running instrument has the devices.
    """
    # A camera serves one program at a time: asked beside a running instrument, it would be lost to that.
    running = holder(rig.storage.root)
    if running is not None:
        raise DeviceRefused("instrument", f"is running (process {running})", "Stop it first: systemctl stop kingfisher")
    with drivers_rig.open_wires(rig.rig.wires, rig.rig.wires_options) as wires:
        # Before any device is opened: a card has one master, and a camera that is in use does not tell its number.
        there = whatever_is_there(rig, wires)
        found = ask_devices(rig, wires)
    return [
        replace(one, details={**one.details, THERE: "; ".join(_there(one.device, there)) or NOTHING}) for one in found
    ]


def whatever_is_there(rig: Rig, wires: Wires) -> BusInventory:
    """List what is on the buses, and on every graphics card. Never raises for a device."""
    outputs = (rig.projector, rig.display)
    # Named ones too, which may be no cards of this machine: their lines say why they could not be asked.
    named = [one.card for one in outputs if one.kind == "kms" and one.card is not None]
    return list_buses(wires, rig.camera.kind, named)


def ask_devices(rig: Rig, wires: Wires, only: Collection[str] | None = None) -> list[Health]:
    """Open each device, or ``only`` those of these names, one after the other; what each says, or why it does not."""
    found: list[Health] = []
    wanted = _wanted_firmware(rig)

    def nothing_to_load(projector: Projector) -> None:
        projector.load([np.zeros((rig.projector.height_px, rig.projector.width_px), np.uint8)])

    with Devices(rig, wires, nothing_to_load) as devices:
        for name, opened in devices.openers().items():
            if only is not None and name not in only:
                continue
            try:
                # Closed again before the next one: what fails at one device must not keep the others from being asked.
                with opened() as device:
                    found.append(_compared(device.health(), wanted.get(name)))
            except DeviceError as error:
                found.append(Health(name, False, f"{error.message}. {error.remedy}"))
    return found


def _there(device: str, there: BusInventory) -> tuple[str, ...]:
    """Return what is on the bus that ``device`` belongs on."""
    if device.startswith("camera."):
        return there.cameras
    return {"board": there.ports, "keys": there.hid}.get(device, there.connectors)


def _wanted_firmware(rig: Rig) -> Mapping[str, str | None]:
    return {
        "camera.left": rig.camera.left.firmware,
        "camera.right": rig.camera.right.firmware,
        "board": rig.board.firmware,
        "keys": rig.keys.firmware,
    }


def _compared(health: Health, firmware: str | None) -> Health:
    """Return ``health``, not ok where the firmware is another than the rig file states: the device is not the one that
    was tested."""
    there = health.details.get("firmware")
    if not health.ok or firmware is None or there == firmware:
        return health
    wrong = f"firmware {there}; the rig file wants {firmware}. Update the device, or correct firmware in the rig file"
    return replace(health, ok=False, summary=wrong)
