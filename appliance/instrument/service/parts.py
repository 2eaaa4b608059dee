"""Devices and controllers that the cycle works with, made by ``app`` and called only by ``loop``.

Parts        devices and controllers of the running instrument
Beginning    facts that are known before the first cycle
LiveViews    live views: pulses, light, lasers, and the latest image of each camera
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.instrument.machine import effects as do
from appliance.instrument.machine import events as on
from appliance.instrument.service.aiming import AimingController
from appliance.instrument.service.calibrating import CalibrationController
from appliance.instrument.service.devices import Devices
from appliance.instrument.service.gallery import GalleryController
from appliance.instrument.service.ranging import RangingController
from appliance.instrument.service.remembered import ChoicesFile
from appliance.instrument.service.scans import ScanController
from appliance.instrument.service.transfer import TransferSwitch
from appliance.measure import SIDES, Fault
from appliance.store import Rig


@dataclass(frozen=True, slots=True)
class Parts:
    """Devices and controllers of the running instrument."""

    devices: Devices
    scans: ScanController
    calibrating: CalibrationController
    gallery: GalleryController
    ranging: RangingController
    aiming: AimingController
    transfer: TransferSwitch


@dataclass(frozen=True, slots=True)
class StartFacts:
    """Facts that are known before the first cycle."""

    choices: ChoicesFile
    """File with the diver's earlier choices."""
    conditions: tuple[Fault, ...]
    """Faults from the start (uncalibrated …)."""
    news: tuple[Fault, ...]
    """Faults of the previous run, which are shown once."""


GUIDES = "left"
"""Camera whose frame clouds are in."""


class LiveViews:
    """Switches live views on and off and takes their images. Called only by the service's cycle."""

    def __init__(self, rig: Rig, parts: Parts, inbox: list[on.Event]) -> None:
        """Prepare; ``inbox`` takes events for the next cycle."""
        self._rig, self._parts, self._inbox = rig, parts, inbox
        self.images: dict[str, NDArray[np.uint8]] = {}
        """The latest image of each camera, (h, w) uint8, by side; a lost camera has none."""
        self._number = dict.fromkeys(SIDES, 0)
        self._guided: int | None = None
        """Number of the object that the diver is guided for; ``None``: none, or there is no light."""

    def begin(self, order: do.GoLive, *, aiming: bool, belongs_to: int | None) -> None:
        """Start light and pulses as ordered, with the lasers off.

        ``aiming``: the diver aims, at the object of number ``belongs_to``.
        """
        devices, scans = self._parts.devices, self._parts.scans
        shown = len(scans.sequence) + (1 if order.light else 0)  # behind the patterns: dark, live light
        devices.expose(order.exposure)
        for camera in devices.cameras.values():
            if camera.value is not None:
                camera.value.live()
        with devices.projector.watched(self._inbox):
            if devices.projector.value is not None:
                devices.projector.value.show(shown)
        with devices.board.watched(self._inbox):
            board = devices.board.value
            if board is not None:
                # Stopped and dark first, so that no earlier sequence or laser goes on.
                board.stop()
                board.set_lasers(False, False)
                board.live(self._rig.board.live_every_vsyncs, self._rig.board.trigger_delay_us, order.exposure.time_us)
        calibration, index = scans.calibration, scans.water.index
        # `switch_lasers_on` follows later: the first images are the proof that the lasers were off (ADR 0024).
        self._parts.ranging.live(order.lasers, calibration, index)
        self._inbox += self._parts.aiming.live(order.light and aiming, calibration, index, order.exposure)
        self._guided = belongs_to if order.light and aiming else None

    def end(self) -> None:
        """Switch projector, lasers and pulses off."""
        devices = self._parts.devices
        self._parts.ranging.stop()
        self._inbox += self._parts.aiming.stop()
        self._guided = None
        with devices.projector.watched(self._inbox):
            if devices.projector.value is not None:
                devices.projector.value.show(len(self._parts.scans.sequence))
        with devices.board.watched(self._inbox):
            if devices.board.value is not None:
                devices.board.value.set_lasers(False, False)
                devices.board.value.stop()

    def switch_lasers_on(self) -> list[on.Event]:
        """Switch the lasers on once live images have shown them off; return the resulting events."""
        board = self._parts.devices.board
        if board.value is None or not self._parts.ranging.wants_lasers:
            return []
        events: list[on.Event] = []
        with board.watched(self._inbox):
            events += self._parts.ranging.switched_on(board.value.set_lasers(True, True))
        return events

    def take(self) -> None:
        """Take each camera's latest image and pass it to ranging, aiming checks and guidance."""
        for side, camera in self._parts.devices.cameras.items():
            latest = camera.value.latest(self._number[side]) if camera.value is not None else None
            if latest is not None:
                self._number[side], self.images[side] = latest
                self._parts.ranging.see(side, latest[1])
                self._parts.aiming.see(side, *latest)
                if side == GUIDES and self._guided is not None:
                    # The worker takes an image now and then and skips those between.
                    self._parts.scans.worker.look(latest[1], self._guided)
            elif camera.value is None:
                # Its numbers begin again when it comes back, and an old image must not pass for a live one.
                self.images.pop(side, None)
                self._number[side] = 0
