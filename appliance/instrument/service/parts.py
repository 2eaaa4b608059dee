"""Owns what the heartbeat is put together from: one controller per duty, made by ``app`` and called by ``loop`` alone."""

from __future__ import annotations

from dataclasses import dataclass

from appliance.instrument.service.aiming import AimingController
from appliance.instrument.service.calibrating import CalibrationController
from appliance.instrument.service.choices import ChoicesFile
from appliance.instrument.service.devices import Devices
from appliance.instrument.service.gallery import GalleryController
from appliance.instrument.service.ranging import RangingController
from appliance.instrument.service.scans import ScanController
from appliance.instrument.service.transfer import TransferSwitch
from appliance.measure import Fault


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
