"""Owns the way from the wish for a sequence to its frames: patterns of the wished period, room in memory, devices
armed, played.

    WAITING   until the scan before is on the disk and the wished patterns are drawn; the machine gives up when that takes too long
    ARMING    lasers off and proven off, cameras waiting for the first pulse; one step per heartbeat, nothing blocks
    ARMED     the machine was told; it answers with Capture or ABORT_CAPTURE

``play`` ends all of it: what is recorded is recorded within one heartbeat, so that nothing else can run meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import moderngl
import numpy as np
from numpy.typing import NDArray

from appliance.instrument.capture.scan import Arming, ScanRecorder, ScanSettings
from appliance.instrument.machine import effects as do
from appliance.instrument.machine import events as on
from appliance.instrument.service.inputs import Inputs
from appliance.instrument.service.parts import Parts
from appliance.instrument.service.settings import live_light_of
from appliance.measure import (
    SIDES,
    Exposure,
    Fault,
    FaultCode,
    PatternSequence,
    Response,
    build_sequence,
    draw_sequence,
)
from appliance.store import Rig
from drivers.api import Clock, Projector


class DrawnPatterns:
    """The sequence in use and its pictures. For the thread that owns GL."""

    def __init__(self, gl: moderngl.Context, rig: Rig, period_px: int, response: Response | None) -> None:
        """``response``: the projector's, that the pictures make up for; ``None``: it was not measured."""
        self._gl, self._rig, self._response = gl, rig, response
        self._pictures: list[NDArray[np.uint8]] = []
        self.sequence = self.use(period_px)

    def use(self, period_px: int) -> PatternSequence:
        """Draw the sequence of another period. A projector that is open has to be loaded again."""
        self.sequence = build_sequence(period_px, self._rig.projector.width_px, self._rig.projector.height_px)
        self._pictures = draw_sequence(self._gl, self.sequence, self._response)
        return self.sequence

    def load(self, projector: Projector) -> None:
        """Load the projector's scan-out memory, with a dark picture behind the last pattern, which is shown, and the
        live views' light behind that. Raises DeviceError."""
        dark = np.zeros((self.sequence.height_px, self.sequence.width_px), np.uint8)
        # Dark directly behind the last pattern: `play` ends on it whatever happens.
        projector.load([*self._pictures, dark, live_light_of(self._rig)])
        projector.show(len(self._pictures))


@dataclass(frozen=True, slots=True)
class _Wanted:
    """A sequence that is wanted."""

    sequence: do.Arm
    arming: Arming | None = None
    """The devices being made ready, once memory is free; ``None``: nothing was done for it yet."""
    told: bool = False
    """The devices are ready, and the machine knows."""


class SequenceRecorder:
    """Makes ready for one sequence at a time and plays it. Called by the heartbeat only."""

    def __init__(
        self, rig: Rig, parts: Parts, patterns: DrawnPatterns, inputs: Inputs, clock: Clock, inbox: list[on.Event]
    ) -> None:
        """``inbox`` takes what happens meanwhile, for the next heartbeat."""
        self._rig, self._parts, self._patterns, self._inputs = rig, parts, patterns, inputs
        self._clock, self._inbox = clock, inbox
        self._wanted: _Wanted | None = None
        """``None``: no sequence is wanted."""
        self._period_px: int | None = None
        """The period that is wanted instead of the one in use; ``None``: none."""

    @property
    def _arming(self) -> Arming | None:
        return None if self._wanted is None else self._wanted.arming

    def want(self, sequence: do.Arm) -> None:
        """Make ready for a sequence from the next ``go_on`` on; it answers Armed or CaptureFailed."""
        if self._arming is not None:
            self._arming.let_go()
        self._wanted = _Wanted(sequence)

    def want_period(self, period_px: int) -> None:
        """Change to patterns of another period as soon as nothing of the last scan needs those in use."""
        self._period_px = period_px

    def go_on(self) -> list[on.Event]:
        """Do what can be done now for what is wanted, without waiting; return what came of it."""
        self._change_period()
        if self._wanted is not None and self._arming is None:
            self._begin(self._wanted.sequence)
        wanted, arming = self._wanted, self._arming
        if wanted is None or arming is None or wanted.told or not arming.poll():
            return []
        self._wanted = replace(wanted, told=True)
        # What the board reported while it was made ready (a heartbeat, a reset) is not lost to the machine.
        for event in arming.events:
            self._inbox += self._inputs.board_event(event)
        arming.events.clear()
        if arming.fault is None:
            return [on.Armed(wanted.sequence.number)]
        self.let_go()
        return [on.CaptureFailed(wanted.sequence.number, arming.fault)]

    def let_go(self) -> None:
        """No sequence follows from what was made ready, and what memory was given for it is free again."""
        arming, self._wanted = self._arming, None
        if arming is not None:
            arming.let_go()
        self._parts.scans.drop()

    def play(self, number: int, draw: Callable[[], None], abort: Callable[[], Fault | None]) -> on.Event:
        """Play the armed sequence and collect its frames, which takes less than a second; return CaptureFinished or
        CaptureFailed. ``abort`` is asked at every vertical blank for a reason to end."""
        arming, self._wanted = self._arming, None
        scans = self._parts.scans
        scan = scans.scan
        recorder = self._recorder((scan.second or scan).exposure) if scan is not None else None
        if arming is None or recorder is None:
            scans.drop()
            return on.CaptureFailed(number, Fault(FaultCode.INTERNAL, "nothing was armed"))
        draw()  # what the diver sees until the sequence has ended, since this thread plays it
        report = recorder.play(scans.sequence, arming, abort)
        for event in report.board_events:
            self._inbox += self._inputs.board_event(event)
        # The witnesses of time first: where a frame is missing, looking at its pixels says nothing.
        fault = report.fault or self._lasers_seen()
        if fault is not None:
            # Where a laser shone in the images, no frame is what it should be.
            if report.fault is not None:
                scans.keep_incomplete(report, report.fault, self._inputs.temperatures_c())
            scans.drop()
            return on.CaptureFailed(number, fault)
        scans.recorded(report, self._inputs.temperatures_c())
        return on.CaptureFinished(number)

    def _change_period(self) -> None:
        # Patterns, frame memory and worker are changed together, and only while nothing of the last scan is on its way
        # to the disk, which reads that memory, and no camera is armed to write into it.
        if self._period_px is None or self._parts.scans.busy or self._arming is not None:
            return
        period_px, self._period_px = self._period_px, None
        # Changed back before anything was done: drawing and starting the worker again would take seconds for nothing.
        if period_px == self._parts.scans.sequence.period_px:
            return
        self._parts.scans.use_sequence(self._patterns.use(period_px))
        projector = self._parts.devices.projector
        with projector.watched(self._inbox):
            if projector.value is not None:
                self._patterns.load(projector.value)

    def _begin(self, wanted: do.Arm) -> None:
        scans = self._parts.scans
        if self._period_px is not None or not scans.settled:
            return  # the machine gives up when this takes too long
        scans.preview = None
        self._parts.devices.expose(wanted.exposure)
        # Memory before devices: a camera that is armed may write as soon as a pulse comes.
        if wanted.second:
            fault = scans.begin_second(wanted.number, wanted.exposure)
        else:
            fault = scans.begin(wanted.number, wanted.exposure, wanted.object)
        recorder = self._recorder(wanted.exposure)
        if fault is None and recorder is None:
            fault = Fault(FaultCode.INTERNAL, "a capture was wanted without all devices")
        if fault is not None or recorder is None:
            self.let_go()
            self._inbox.append(on.CaptureFailed(wanted.number, fault or Fault(FaultCode.INTERNAL, "no device")))
            return
        self._wanted = _Wanted(
            wanted, recorder.arm(scans.sequence, scans.store, scans.worker.frame, second=wanted.second)
        )

    def _recorder(self, exposure: Exposure) -> ScanRecorder | None:
        """Return a recorder with the devices as they are; ``None`` without all of them."""
        devices = self._parts.devices
        grabbers = {side: camera.value for side, camera in devices.cameras.items()}
        ready = {side: grabber for side, grabber in grabbers.items() if grabber is not None}
        board, projector = devices.board.value, devices.projector.value
        if board is None or projector is None or len(ready) < len(SIDES):
            return None
        settings = ScanSettings(
            refresh_hz=self._rig.projector.refresh_hz,
            exposure_us=exposure.time_us,
            trigger_delay_us=self._rig.board.trigger_delay_us,
            latency_blanks=self._rig.projector.latency_blanks,
        )
        return ScanRecorder(ready, board, projector, self._clock, settings)

    def _lasers_seen(self) -> Fault | None:
        """Return the images' own proof that a laser was on, besides the board's word; ``None``: they were off."""
        scans = self._parts.scans
        sequence, store = scans.sequence, scans.store
        bright, dark = ({side: store.frames(side)[k] for side in SIDES} for k in (sequence.bright, sequence.dark))
        return self._parts.ranging.shining(bright, dark)
