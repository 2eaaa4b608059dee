"""The checks of ``kingfisher check``: each device as it identifies itself, compared with the rig file."""

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
"""Key in a device's details for the entries of its bus, and the value if there are none."""


def check(rig: Rig) -> list[Health]:
    """Open every device once, one after the other, through the shipped drivers, and collect their health.

    A device that is missing, refused, or not as the rig file states is not ``ok``; its summary has the reason and the
    remedy. Raises DeviceError if the wires cannot be opened, or the running instrument has the devices.
    """
    # A camera serves one program at a time: the running instrument would lose it.
    running = holder(rig.storage.root)
    if running is not None:
        raise DeviceRefused("instrument", f"is running (process {running})", "Stop it first: systemctl stop kingfisher")
    with drivers_rig.open_wires(rig.rig.wires, rig.rig.wires_options) as wires:
        # Before any device is opened: a card has one master, and a camera in use does not report its serial number.
        buses = connected_devices(rig, wires)
        healths = ask_devices(rig, wires)
    return [
        replace(health, details={**health.details, THERE: "; ".join(_on_bus(health.device, buses)) or NOTHING})
        for health in healths
    ]


def connected_devices(rig: Rig, wires: Wires) -> BusInventory:
    """List the devices on the buses and on every graphics card. Never raises for a device."""
    outputs = (rig.projector, rig.display)
    # Cards of the rig file as well, even if this computer lacks them: their lines give the reason.
    named = [output.card for output in outputs if output.kind == "kms" and output.card is not None]
    return list_buses(wires, rig.camera.kind, named)


def ask_devices(rig: Rig, wires: Wires, only: Collection[str] | None = None) -> list[Health]:
    """Open each device, or ``only`` those of these names; return the health or the error of each."""
    healths: list[Health] = []
    firmware = _wanted_firmware(rig)

    def nothing_to_load(projector: Projector) -> None:
        projector.load([np.zeros((rig.projector.height_px, rig.projector.width_px), np.uint8)])

    with Devices(rig, wires, nothing_to_load) as devices:
        for name, opened in devices.openers().items():
            if only is not None and name not in only:
                continue
            try:
                # Closed before the next one, so that a failure of one device does not affect the others.
                with opened() as device:
                    healths.append(_with_firmware_checked(device.health(), firmware.get(name)))
            except DeviceError as error:
                healths.append(Health(name, False, f"{error.message}. {error.remedy}"))
    return healths


def _on_bus(device: str, buses: BusInventory) -> tuple[str, ...]:
    """Return the entries of the bus to which ``device`` belongs."""
    if device.startswith("camera."):
        return buses.cameras
    return {"board": buses.ports, "keys": buses.hid}.get(device, buses.connectors)


def _wanted_firmware(rig: Rig) -> Mapping[str, str | None]:
    return {
        "camera.left": rig.camera.left.firmware,
        "camera.right": rig.camera.right.firmware,
        "board": rig.board.firmware,
        "keys": rig.keys.firmware,
    }


def _with_firmware_checked(health: Health, firmware: str | None) -> Health:
    """Return ``health``, not ok if the firmware differs from the tested one in the rig file."""
    actual = health.details.get("firmware")
    if not health.ok or firmware is None or actual == firmware:
        return health
    wrong = f"firmware {actual}; the rig file wants {firmware}. Update the device, or correct firmware in the rig file"
    return replace(health, ok=False, summary=wrong)
