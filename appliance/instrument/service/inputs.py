"""Events from keys and board for the machine, and the latest telemetry."""

from __future__ import annotations

import logging
from typing import assert_never

from appliance.instrument.machine import events as on
from appliance.instrument.service.devices import Devices
from appliance.instrument.service.ranging import RangingController
from drivers.api import (
    BoardBooted,
    BoardEvent,
    BoardLost,
    KeyEvent,
    KeyFreed,
    KeyLongPress,
    KeyPress,
    KeyRelease,
    KeysLost,
    KeyStuck,
    Pulse,
    PulsesDone,
    Telemetry,
    VsyncLost,
)

log = logging.getLogger("kingfisher")

MAX_BOARD_EVENTS = 200
"""Most reports of the board in one cycle: a board that floods its line must not stop the service."""


class Inputs:
    """Reads the keypad and the board. Called only by the service's cycle; never waits."""

    def __init__(self, devices: Devices, ranging: RangingController) -> None:
        """Prepare; ``ranging`` gets the lasers' state as the board reports it."""
        self._devices, self._ranging = devices, ranging
        self.telemetry: Telemetry | None = None
        """The board's latest report; ``None`` before the first."""

    def poll(self) -> list[on.Event]:
        """Return the events since the last call: keys first, then the board."""
        events = self.keys()
        board = self._devices.board.value
        if board is not None:
            for _ in range(MAX_BOARD_EVENTS):
                report = board.next_event(0.0)
                if report is None:
                    break
                events += self.board_event(report)
        return events

    def keys(self) -> list[on.Event]:
        """Return the events of the keys since the last call."""
        reader = self._devices.keys.value
        return [] if reader is None else [event for key in reader.take() for event in self._key(key)]

    def board_event(self, event: BoardEvent) -> list[on.Event]:
        """Return the events for one report of the board."""
        match event:
            case Telemetry():
                self.telemetry = event
                return [event, *self._ranging.heard(event.lasers)]
            case BoardBooted():
                return [event]
            case BoardLost():
                return [*self._devices.board.lose(event.reason)]
            case VsyncLost():
                log.warning("the board sees no vertical sync from the projector's video")
                return []
            case Pulse() | PulsesDone():
                return []  # of a sequence that was given up
            case _:
                assert_never(event)

    def temperatures_c(self) -> dict[str, float | None]:
        """Return the latest temperature of each part in °C, by its name in a scan's record, or ``None``."""
        t = self.telemetry
        values: dict[str, float | None] = {
            "projector": t.temperature_projector_c if t else None,
            "case": t.temperature_case_c if t else None,
            "board": t.temperature_board_c if t else None,
        }
        for side, camera in self._devices.cameras.items():
            values[f"camera_{side}"] = camera.value.temperature_c if camera.value is not None else None
        return values

    def _key(self, event: KeyEvent) -> list[on.Event]:
        match event:
            case KeyPress() | KeyLongPress() | KeyStuck() | KeyFreed():
                return [event]
            case KeyRelease():
                return []
            case KeysLost():
                return [*self._devices.keys.lose(event.reason)]
            case _:
                assert_never(event)
