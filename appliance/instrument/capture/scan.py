"""One capture: lasers off, cameras ready, board armed, patterns played, frames collected, audited.

It runs in the thread of the screens; meanwhile the two camera threads fill the frame store.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sized
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from appliance.instrument.capture.grabber import Grabber, SideRecording, Timeouts
from appliance.instrument.capture.ledger import Ledger, SyncError, SyncMap, audit, frame_fault, synchronise
from appliance.instrument.capture.store import FrameStore
from appliance.measure import SIDES, Fault, FaultCode
from drivers.api import (
    Board,
    BoardBooted,
    BoardEvent,
    BoardLost,
    Clock,
    DeviceError,
    Flip,
    Projector,
    Pulse,
    PulsesDone,
    VsyncLost,
)

LEAD_BLANKS = 3
"""Vertical blanks between arming and the first pattern: time for the answer to travel."""
ARM_POLL_S = 0.002
MAX_BOARD_EVENTS = 400


@dataclass(frozen=True, slots=True)
class ScanSettings:
    """Settings of a sequence's trigger."""

    refresh_hz: float
    exposure_us: int
    trigger_delay_us: int
    latency_blanks: int = 0
    """Blanks from a flip to its light."""

    @property
    def timeouts(self) -> Timeouts:
        """Time limits of the capture, from the projector's rate."""
        return Timeouts(self.refresh_hz)


@dataclass(frozen=True, slots=True)
class CaptureReport:
    """Result of a capture. With a fault there is no cloud; the frames are evidence only."""

    fault: Fault | None
    ledger: Ledger
    recording_s: float
    board_events: tuple[BoardEvent, ...]
    """Other events of the board during the capture (telemetry, resets)."""


class Arming:
    """Preparation of one sequence: lasers proven off, then both cameras waiting for the first pulse.

    It never waits, so that the service's cycle goes on. Exceeding the time limit is a fault.
    """

    def __init__(
        self,
        grabbers: Mapping[str, Grabber],
        board: Board,
        clock: Clock,
        slots: Mapping[str, NDArray[np.uint8]],
        on_frame: Callable[[str, int], None],
        ready_s: float,
    ) -> None:
        self._grabbers, self._board, self._clock = grabbers, board, clock
        self._ready_s = ready_s
        self._slots, self._on_frame = slots, on_frame
        self.recordings: dict[str, SideRecording] = {}
        self.events: list[BoardEvent] = []
        """Events that the board sent meanwhile."""
        self.fault: Fault | None = None
        try:
            self._lights_off()
        except DeviceError as error:
            self.fault = device_fault(error.device, error.message)
        for grabber in self._grabbers.values():
            grabber.leave()  # both at once, so that one waiting time is enough
        self._wait_on()

    def poll(self) -> bool:
        """Go on; return True when both cameras are ready, or there is a fault."""
        if self.fault is not None:
            return True
        if not self.recordings:
            if not all(grabber.idle(0.0) for grabber in self._grabbers.values()):
                return self._late("did not leave live view", lambda side: self._grabbers[side].idle(0.0))
            try:
                self._read_away()
            except DeviceError as error:
                self.fault = device_fault(error.device, error.message)
                return True
            for side, slots in self._slots.items():
                self.recordings[side] = self._grabbers[side].record(slots, partial(self._on_frame, side))
            self._wait_on()
        if all(self._ready(side) for side in self.recordings):
            return True
        return self._late("did not start", self._ready)

    def let_go(self) -> None:
        """Cancel the preparation: the cameras stop waiting."""
        for side, recording in self.recordings.items():
            self._grabbers[side].cancel(recording)
            self._grabbers[side].leave()

    def _lights_off(self) -> None:
        self._board.stop()
        lasers = self._board.set_lasers(False, False)
        if lasers.left_on or lasers.right_on:
            which = " and ".join(n for n, on in (("left", lasers.left_on), ("right", lasers.right_on)) if on)
            self.fault = Fault(FaultCode.LASER_ON, f"the {which} laser still conducts after switching off", {}, "board")

    def _read_away(self) -> None:
        """Discard earlier reports of the board: pulses of the live views are among them."""
        for _ in range(MAX_BOARD_EVENTS):
            event = self._board.next_event(0.0)
            if event is None:
                return
            if not isinstance(event, Pulse | PulsesDone):
                self.events.append(event)

    def _ready(self, side: str) -> bool:
        return self._grabbers[side].wait(self.recordings[side], "ready", 0.0)

    def _wait_on(self) -> None:
        self._until_ns = self._clock.now_ns() + int(self._ready_s * 1e9)

    def _late(self, what: str, done: Callable[[str], bool]) -> bool:
        if self._clock.now_ns() < self._until_ns:
            return False
        side = next((side for side in self._grabbers if not done(side)), SIDES[0])
        detail = f"camera.{side} {what} in {self._ready_s:g} s"
        self.fault = Fault(FaultCode.CAMERA_REFUSED, detail, {}, f"camera.{side}")
        return True


class ScanRecorder:
    """Records sequences with open devices and loaded patterns (index = frame, ``idle`` = dark).

    The content of the patterns does not matter, only their number.
    """

    def __init__(
        self,
        grabbers: Mapping[str, Grabber],
        board: Board,
        projector: Projector,
        clock: Clock,
        settings: ScanSettings,
    ) -> None:
        self._grabbers = grabbers
        self._board = board
        self._projector = projector
        self._clock = clock
        self._settings = settings

    def arm(
        self,
        sequence: Sized,
        store: FrameStore,
        on_frame: Callable[[str, int], None],
        *,
        second: bool = False,
    ) -> Arming:
        """Begin to prepare a sequence; ``poll`` the answer until it is done, then ``play``.

        The frames go into ``store``, those of a ``second`` sequence into its second part. ``on_frame(side, index)`` is
        called in the camera threads as frames arrive.
        """
        slots = {side: store.frames(side, second=second)[: len(sequence)] for side in SIDES}
        return Arming(self._grabbers, self._board, self._clock, slots, on_frame, self._settings.timeouts.ready_s)

    def record(
        self,
        sequence: Sized,
        store: FrameStore,
        on_frame: Callable[[str, int], None],
        abort: Callable[[], Fault | None],
    ) -> CaptureReport:
        """Arm, wait and play; for callers that may block."""
        arming = self.arm(sequence, store, on_frame)
        while not arming.poll():
            self._clock.sleep_s(ARM_POLL_S)
        return self.play(sequence, arming, abort)

    def play(self, sequence: Sized, arming: Arming, abort: Callable[[], Fault | None]) -> CaptureReport:
        """Record the armed sequence. Device errors are not raised, but become the report's fault.

        ``abort()`` is called at every vertical blank and ends the scan with the fault it returns. Ends within the
        sequence's length and the margin of ``Timeouts``.
        """
        period_ns, timeouts = 1e9 / self._settings.refresh_hz, self._settings.timeouts
        latency = self._settings.latency_blanks
        begun_ns = self._clock.now_ns()
        recordings, events = arming.recordings, arming.events
        flips: list[Flip] = []
        sync: list[SyncMap] = []
        start: list[int | None] = []
        fault = arming.fault

        def should_stop() -> bool:
            nonlocal fault
            fault = fault or abort()
            return fault is not None or any(r.done and not r.complete for r in recordings.values())

        def arm(flip: Flip) -> int | None:
            sync_map = synchronise(self._board, flip, period_ns)
            # The board needs the vsync at which it begins, and the first flip must be queued by then: blanks that
            # passed during the queries are added.
            lead_blanks = LEAD_BLANKS + round((self._clock.now_ns() - flip.time_ns) / period_ns)
            first_light = sync_map.count + lead_blanks + latency
            self._board.arm(len(sequence), first_light, self._settings.trigger_delay_us, self._settings.exposure_us)
            sync.append(sync_map)
            start.append(None if flip.sequence is None else flip.sequence + lead_blanks)
            start.append(first_light)
            return (flip.sequence or 0) + lead_blanks

        try:
            if fault is None:
                flips = self._projector.play(range(len(sequence)), len(sequence), arm, should_stop)
            # After the last flip the cameras still deliver the last frames; after an early end they are cancelled.
            is_complete = len(flips) == len(sequence)
            for side in SIDES:
                if is_complete:
                    self._grabbers[side].wait(recordings[side], "done", timeouts.collect_s + latency * period_ns / 1e9)
        except SyncError as error:
            fault = Fault(FaultCode.SYNC_LOST, str(error), {}, "board")
        except DeviceError as error:
            fault = device_fault(error.device, error.message)
        recording_s = (self._clock.now_ns() - begun_ns) / 1e9
        played = len(flips) == len(sequence) and fault is None
        if not played:
            self._disarm()  # at once: the rest of the sequence would be dark
        for side, recording in recordings.items():
            if not recording.done:
                self._grabbers[side].cancel(recording)
                self._grabbers[side].wait(recording, "done", timeouts.collect_s)
        # Collected after the frames: most of the reports have arrived by then.
        pulses = self._collect_pulses(len(sequence) if played else 0, events)
        # With a pulse missing, the board may still be armed and would expose the live views.
        if played and len(pulses) < len(sequence):
            self._disarm()
        ledger = Ledger(
            expected=len(sequence),
            period_ns=period_ns,
            start_sequence=start[0] if start else None,
            start_vsync=start[1] if start else None,
            delay_us=self._settings.trigger_delay_us,
            latency_blanks=latency,
            flips=tuple(flips),
            pulses=tuple(pulses),
            frames={side: tuple(r.frames) for side, r in recordings.items()},
            sync=sync[0] if sync else None,
            clocks={side: r.clock for side, r in recordings.items() if r.clock is not None},
        )
        return CaptureReport(
            fault=_first_fault(fault, recordings, events, ledger),
            ledger=ledger,
            recording_s=recording_s,
            board_events=tuple(events),
        )

    def _collect_pulses(self, expected: int, events: list[BoardEvent]) -> list[Pulse]:
        pulses: list[Pulse] = []
        for _ in range(MAX_BOARD_EVENTS):
            event = self._board.next_event(self._settings.timeouts.pulse_s if expected else 0.0)
            match event:
                case None | PulsesDone():
                    break
                case Pulse():
                    pulses.append(event)
                case _:
                    events.append(event)
        return pulses

    def _disarm(self) -> None:
        with suppress(DeviceError):  # its loss is reported by its own event
            self._board.stop()


def device_fault(device: str, detail: str) -> Fault:
    """Return the fault of a scan for a lost device."""
    codes = {"projector": FaultCode.PROJECTOR_LOST, "display": FaultCode.DISPLAY_LOST, "board": FaultCode.BOARD_LOST}
    code = FaultCode.CAMERA_LOST if device.startswith("camera") else codes.get(device, FaultCode.INTERNAL)
    return Fault(code, detail, {}, device)


def _first_fault(
    fault: Fault | None, recordings: Mapping[str, SideRecording], events: list[BoardEvent], ledger: Ledger
) -> Fault | None:
    """Return the fault to report: a lost device, else the reason that stopped the play, else the audit's."""
    # A lost camera looks like missing frames, a restarted board like missing pulses: the cause is reported.
    for side, recording in recordings.items():
        if recording.lost is not None:
            return device_fault(f"camera.{side}", recording.lost)
    for event in events:
        match event:
            case BoardBooted():
                return Fault(FaultCode.BOARD_RESET, f"the board restarted ({event.cause})", {}, "board")
            case BoardLost():
                return Fault(FaultCode.BOARD_LOST, event.reason, {}, "board")
            case VsyncLost():
                return Fault(FaultCode.VSYNC_LOST, "no vertical sync from the projector's video", {}, "board")
            case _:
                pass
    if fault is not None:
        return fault
    if _stopped_by_frame(ledger):
        frame_faults = [fault for fault in (frame_fault(ledger, side) for side in SIDES) if fault is not None]
        # The other camera was cancelled and lacks frames, too: damage is the cause, missing frames may be the effect.
        frame_faults.sort(key=lambda candidate: candidate.code is FaultCode.FRAME_MISSING)
        return frame_faults[0] if frame_faults else audit(ledger)
    return audit(ledger)


def _stopped_by_frame(ledger: Ledger) -> bool:
    """Return True if a bad frame stopped the play: the flips were in time, but not all were played."""
    if len(ledger.flips) == ledger.expected or not ledger.flips:
        return False
    last = ledger.flips[-1].sequence
    return last is None or ledger.start_sequence is None or last == ledger.start_sequence + len(ledger.flips) - 1
