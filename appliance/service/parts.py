"""Owns what the heartbeat is put together from: one controller per duty, made by ``app`` and called by ``loop`` alone."""

from __future__ import annotations

from dataclasses import dataclass

from appliance.scan.fault import Fault
from appliance.service.aiming import AimingController
from appliance.service.calibrating import CalibrationController
from appliance.service.devices import Devices
from appliance.service.gallery import GalleryController
from appliance.service.ranging import RangingController
from appliance.service.scans import ScanController
from appliance.service.transfer import TransferSwitch
from appliance.storage.choices import ChoicesFile


@dataclass(frozen=True, slots=True)
class Parts:
    """The devices and the controllers of the running instrument."""

    devices: Devices
    scans: ScanController
    calibrating: CalibrationController
    gallery: GalleryController
    ranging: RangingController
    aiming: AimingController
    transfer: TransferSwitch


@dataclass(frozen=True, slots=True)
class Beginning:
    """The knowledge that there is before the first heartbeat."""

    choices: ChoicesFile
    """The file of what the diver chose before."""
    conditions: tuple[Fault, ...]
    """Faults that hold from the start (uncalibrated …)."""
    news: tuple[Fault, ...]
    """Faults of the run before, which are told once."""
