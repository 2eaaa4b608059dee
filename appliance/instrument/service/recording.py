"""Recording a sequence: patterns of the requested period, memory, armed devices, and the play.

    WAITING   until the scan before is on the disk and the patterns are drawn; the machine limits the time
    ARMING    lasers off and proven off, cameras waiting for the first pulse; one step per cycle, without waiting
    ARMED     reported to the machine, which answers with Capture or ABORT_CAPTURE

``play`` ends all of it: a sequence is recorded within one cycle of the service, without interruption.
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
        """Draw the sequence; ``response``: the projector's, if measured, which the pictures compensate."""
        self._gl, self._rig, self._response = gl, rig, response
        self._pictures: list[NDArray[np.uint8]] = []
        self.sequence = self.use(period_px)

    def use(self, period_px: int) -> PatternSequence:
        """Draw the sequence of another period. An open projector has to be loaded again."""
        self.sequence = build_sequence(period_px, self._rig.projector.width_px, self._rig.projector.height_px)
        self._pictures = draw_sequence(self._gl, self.sequence, self._response)
        return self.sequence

    def load(self, projector: Projector) -> None:
        """Load the projector's memory: the patterns, a dark picture, which is shown, and the live light.

        Raises DeviceError.
        """
        dark = np.zeros((self.sequence.height_px, self.sequence.width_px), np.uint8)
        # Dark directly after the last pattern: `play` always ends with it.
        projector.load([*self._pictures, dark, live_light_of(self._rig)])
        projector.show(len(self._pictures))


@dataclass(frozen=True, slots=True)
class _Request:
    """A requested sequence."""

    sequence: do.Arm
    arming: Arming | None = None
    """The preparation of the devices, once memory is free; ``None``: not begun."""
    is_reported: bool = False
    """True if the machine knows that the devices are ready."""


class SequenceRecorder:
    """Prepares one sequence at a time and plays it. Called only by the service's cycle."""

    def __init__(
        self, rig: Rig, parts: Parts, patterns: DrawnPatterns, inputs: Inputs, clock: Clock, inbox: list[on.Event]
    ) -> None:
        """Prepare; ``inbox`` takes events for the next cycle."""
        self._rig, self._parts, self._patterns, self._inputs = rig, parts, patterns, inputs
        self._clock, self._inbox = clock, inbox
        self._request: _Request | None = None
        """``None``: no sequence is requested."""
        self._period_px: int | None = None
        """The requested period, if it differs from the one in use."""

    @property
    def _arming(self) -> Arming | None:
        return None if self._request is None else self._request.arming

    def request(self, sequence: do.Arm) -> None:
        """Prepare a sequence from the next ``go_on`` on; it answers Armed or CaptureFailed."""
        if self._arming is not None:
            self._arming.let_go()
        self._request = _Request(sequence)

    def request_period(self, period_px: int) -> None:
        """Change to patterns of another period as soon as the last scan no longer needs the present ones."""
        self._period_px = period_px

    def go_on(self) -> list[on.Event]:
        """Advance the requested work without waiting; return the resulting events."""
        self._change_period()
        if self._request is not None and self._arming is None:
            self._begin(self._request.sequence)
        request, arming = self._request, self._arming
        if request is None or arming is None or request.is_reported or not arming.poll():
            return []
        self._request = replace(request, is_reported=True)
        # The board's reports during the preparation (a heartbeat, a reset) are passed to the machine.
        for event in arming.events:
            self._inbox += self._inputs.board_event(event)
        arming.events.clear()
        if arming.fault is None:
            return [on.Armed(request.sequence.number)]
        self.let_go()
        return [on.CaptureFailed(request.sequence.number, arming.fault)]

    def let_go(self) -> None:
        """Cancel the requested sequence and free its memory."""
        arming, self._request = self._arming, None
        if arming is not None:
            arming.let_go()
        self._parts.scans.drop()

    def play(self, number: int, draw: Callable[[], None], abort: Callable[[], Fault | None]) -> on.Event:
        """Play the armed sequence and collect its frames, in less than a second.

        Returns CaptureFinished or CaptureFailed. ``abort`` is called at every vertical blank for a reason to end.
        """
        arming, self._request = self._arming, None
        scans = self._parts.scans
        scan = scans.scan
        recorder = self._recorder((scan.second or scan).exposure) if scan is not None else None
        if arming is None or recorder is None:
            scans.drop()
            return on.CaptureFailed(number, Fault(FaultCode.INTERNAL, "nothing was armed"))
        draw()  # the screen until the sequence has ended, since this thread plays it
        report = recorder.play(scans.sequence, arming, abort)
        for event in report.board_events:
            self._inbox += self._inputs.board_event(event)
        # The ledger's fault first: with a frame missing, its pixels are no evidence.
        fault = report.fault or self._lasers_seen()
        if fault is not None:
            # With a laser in the images, all frames are spoilt, so they are not kept.
            if report.fault is not None:
                scans.keep_incomplete(report, report.fault, self._inputs.temperatures_c())
            scans.drop()
            return on.CaptureFailed(number, fault)
        scans.recorded(report, self._inputs.temperatures_c())
        return on.CaptureFinished(number)

    def _change_period(self) -> None:
        # Patterns, frame memory and worker are changed together, and only while the disk does not read that memory and
        # no camera is armed to write into it.
        if self._period_px is None or self._parts.scans.busy or self._arming is not None:
            return
        period_px, self._period_px = self._period_px, None
        # Changed back meanwhile: drawing and starting the worker again would take seconds.
        if period_px == self._parts.scans.sequence.period_px:
            return
        self._parts.scans.use_sequence(self._patterns.use(period_px))
        projector = self._parts.devices.projector
        with projector.watched(self._inbox):
            if projector.value is not None:
                self._patterns.load(projector.value)

    def _begin(self, order: do.Arm) -> None:
        scans = self._parts.scans
        if self._period_px is not None or not scans.settled:
            return  # the machine gives up when this takes too long
        scans.preview = None
        self._parts.devices.expose(order.exposure)
        # Memory before devices: an armed camera writes as soon as a pulse comes.
        if order.second:
            fault = scans.begin_second(order.number, order.exposure)
        else:
            fault = scans.begin(order.number, order.exposure, order.object)
        recorder = self._recorder(order.exposure)
        if fault is None and recorder is None:
            fault = Fault(FaultCode.INTERNAL, "a capture was requested without all devices")
        if fault is not None or recorder is None:
            self.let_go()
            self._inbox.append(on.CaptureFailed(order.number, fault or Fault(FaultCode.INTERNAL, "no device")))
            return
        self._request = _Request(
            order, recorder.arm(scans.sequence, scans.store, scans.worker.frame, second=order.second)
        )

    def _recorder(self, exposure: Exposure) -> ScanRecorder | None:
        """Return a recorder with the present devices; ``None`` if one is missing."""
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
        """Return a fault if the images show that a laser was on, independently of the board."""
        scans = self._parts.scans
        sequence, store = scans.sequence, scans.store
        bright, dark = ({side: store.frames(side)[k] for side in SIDES} for k in (sequence.bright, sequence.dark))
        return self._parts.ranging.shining(bright, dark)
