"""Owns what the heartbeat works with: one controller per duty, made by ``app`` and called by ``loop`` alone.

Parts        devices and controllers of the running instrument
Beginning    what is known before the first heartbeat
LiveViews    cameras fired without a sequence, their light and their lasers, and the latest image of each
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


GUIDES = "left"
"""Camera whose frame clouds are in."""


class LiveViews:
    """Switches live views on and off and takes their images. Called by the heartbeat only."""

    def __init__(self, rig: Rig, parts: Parts, inbox: list[on.Event]) -> None:
        """``inbox`` takes what happens meanwhile, for the next heartbeat."""
        self._rig, self._parts, self._inbox = rig, parts, inbox
        self.images: dict[str, NDArray[np.uint8]] = {}
        """The latest image of each camera, (h, w) uint8, by side; nothing of a camera that is lost."""
        self._number = dict.fromkeys(SIDES, 0)
        self._guided: int | None = None
        """Number of the object that the diver is guided for; ``None``: there is none, or nothing lights it."""

    def begin(self, wanted: do.GoLive, *, aiming: bool, belongs_to: int | None) -> None:
        """Light and fire the cameras as ``wanted``, with the lasers off; ``aiming``: the diver aims by it, at an object
        of that number."""
        devices, scans = self._parts.devices, self._parts.scans
        shown = len(scans.sequence) + (1 if wanted.light else 0)  # behind the patterns: dark, live light
        devices.expose(wanted.exposure)
        for camera in devices.cameras.values():
            if camera.value is not None:
                camera.value.live()
        with devices.projector.watched(self._inbox):
            if devices.projector.value is not None:
                devices.projector.value.show(shown)
        with devices.board.watched(self._inbox):
            board = devices.board.value
            if board is not None:
                # Stopped before it fires anew, and dark before it is lit: a sequence or lasers of before must not go
                # on.
                board.stop()
                board.set_lasers(False, False)
                board.live(self._rig.board.live_every_vsyncs, self._rig.board.trigger_delay_us, wanted.exposure.time_us)
        calibration, index = scans.calibration, scans.water.index
        # The lasers go on later, by `switch_lasers_on`: the first images are the proof that they were off (ADR 0024).
        self._parts.ranging.live(wanted.lasers, calibration, index)
        self._inbox += self._parts.aiming.live(wanted.light and aiming, calibration, index, wanted.exposure)
        self._guided = belongs_to if wanted.light and aiming else None

    def end(self) -> None:
        """Make everything dark: projector, lasers, and no image is asked for."""
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
        """Switch the lasers on as soon as the live images were seen without them; return what that led to."""
        board = self._parts.devices.board
        if board.value is None or not self._parts.ranging.wants_lasers:
            return []
        events: list[on.Event] = []
        with board.watched(self._inbox):
            events += self._parts.ranging.switched_on(board.value.set_lasers(True, True))
        return events

    def take(self) -> None:
        """Take each camera's latest image and show it to whoever measures in live images."""
        for side, camera in self._parts.devices.cameras.items():
            latest = camera.value.latest(self._number[side]) if camera.value is not None else None
            if latest is not None:
                self._number[side], self.images[side] = latest
                self._parts.ranging.see(side, latest[1])
                self._parts.aiming.see(side, *latest)
                if side == GUIDES and self._guided is not None:
                    # It takes one now and then; those between are of no interest.
                    self._parts.scans.worker.look(latest[1], self._guided)
            elif camera.value is None:
                # Its numbers begin anew when it comes back, and an old image must not be taken for a live one.
                self.images.pop(side, None)
                self._number[side] = 0
