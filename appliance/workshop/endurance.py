"""The step ``endurance``: minutes at full rate without a lost frame or too much heat.

The board fires 64 reported pulses, is armed again, and so on; the cameras stream through all of it. All frames are
written into one slot: they would fill any memory, and their content does not matter.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from appliance.instrument import Devices, Grabber, SideRecording, Timeouts, open_devices
from appliance.workshop.finding import BringupError, Finding, finding_of
from appliance.workshop.step import StepOutcome, Workplace
from appliance.workshop.trigger import PULSES
from drivers.api import (
    Board,
    BoardBooted,
    BoardEvent,
    BoardLost,
    Clock,
    DeviceError,
    FrameStatus,
    Projector,
    Pulse,
    PulsesDone,
    Telemetry,
    VsyncLost,
)
from drivers.board import TriggerBoard

LEAD_SYNCS = 3
"""Syncs between arming and the first pulse, so that the answer arrives in time."""
IDLE_S = 1.5
"""Time in which an idle camera reports its temperature, and the board sends a heartbeat."""
MOST_EVENTS = 400


@dataclass(frozen=True, slots=True)
class CameraEndurance:
    """One camera's part in an endurance run."""

    complete: int
    """Number of complete frames."""
    bad: tuple[str, ...]
    """Status of each other frame, in the driver's words."""
    without_stamp: int
    """Number of complete frames without a time by the camera's clock."""
    gaps: int
    """Number of places at which block ids do not grow by one."""
    lost: str | None = None
    """Reason why the camera was lost; ``None``: it was not."""


@dataclass(frozen=True, slots=True)
class EnduranceRun:
    """All observations of an endurance run."""

    minutes: float
    """Actual duration of the run."""
    wanted_minutes: float
    pulses: int
    """Number of pulses requested."""
    reported: int
    """Number of pulses that the board reported."""
    lost_reports: int
    cameras: Mapping[str, CameraEndurance]
    before_c: Mapping[str, float | None]
    """Temperatures by place before the run; ``None``: not known."""
    after_c: Mapping[str, float | None]
    ended_by: str | None = None
    """Event that ended the run before its time; ``None``: none did."""


@dataclass(slots=True)
class _PulseCount:
    """The board's part in an endurance run."""

    requested: int = 0
    reported: int = 0
    ended_by: str | None = None
    latest: Telemetry | None = field(default=None)

    def take(self, event: BoardEvent | None) -> bool:
        """Count an event; return True where the series is over."""
        match event:
            case Pulse():
                self.reported += 1
            case Telemetry():
                self.latest = event
            case BoardBooted(cause=cause):
                self.ended_by = f"the board restarted ({cause})"
            case BoardLost(reason=reason):
                self.ended_by = f"the board was lost ({reason})"
            case VsyncLost():
                self.ended_by = "the board saw no more vertical syncs"
            case _:
                pass
        return isinstance(event, PulsesDone) or self.ended_by is not None


def do(workplace: Workplace) -> StepOutcome:
    """Do the step. Raises DeviceError, BringupError."""
    rig = workplace.rig
    black = np.zeros((rig.projector.height_px, rig.projector.width_px), np.uint8)

    def load(projector: Projector) -> None:
        projector.load([black])
        projector.show(0)

    with Devices(rig, workplace.wires, load) as devices:
        grabbers, board, _ = open_devices(devices, workplace.wires.clock)
        endured = _run_endurance(workplace, grabbers, board)
    warm_c = {"projector": rig.limits.projector_warm_c, "case": rig.limits.case_warm_c}
    return StepOutcome(judge_endurance(endured, warm_c))


def _run_endurance(workplace: Workplace, grabbers: Mapping[str, Grabber], board: Board) -> EnduranceRun:
    """Do the run. Raises DeviceError, BringupError."""
    rig, clock = workplace.rig, workplace.wires.clock
    series = max(1, round(60.0 * workplace.minutes * rig.projector.refresh_hz / PULSES))
    # Before the cameras stream and warm up, so that the rise is known.
    before_c = _temperatures(grabbers, board, clock)
    lost_before = _lost_reports(board)
    slots = _one_slot(rig.camera.left.height_px, rig.camera.left.width_px, PULSES * series)
    recordings = {side: grabber.record(slots[side], lambda _index: None) for side, grabber in grabbers.items()}
    # From here on the cameras wait for pulses: their recordings are ended in any case.
    start_ns = clock.now_ns()
    try:
        pulse_count = _fire(workplace, board, grabbers, recordings, series)
        passed_s = (clock.now_ns() - start_ns) / 1e9
    finally:
        with suppress(DeviceError):
            board.stop()
        _end(grabbers, recordings, Timeouts(rig.projector.refresh_hz))
    return EnduranceRun(
        minutes=passed_s / 60.0,
        wanted_minutes=workplace.minutes,
        pulses=pulse_count.requested,
        reported=pulse_count.reported,
        lost_reports=_lost_reports(board) - lost_before,
        cameras={side: _camera_endurance(recording) for side, recording in recordings.items()},
        before_c=before_c,
        after_c=_temperatures(grabbers, board, clock),
        ended_by=pulse_count.ended_by,
    )


def _one_slot(height_px: int, width_px: int, count: int) -> dict[str, NDArray[np.uint8]]:
    """Return ``count`` images (count, h, w) for each camera that all lie in the same memory."""
    images = {}
    for side in ("left", "right"):
        image = np.zeros((height_px, width_px), np.uint8)
        images[side] = as_strided(image, (count, height_px, width_px), (0, *image.strides), writeable=True)
    return images


def _fire(
    workplace: Workplace,
    board: Board,
    grabbers: Mapping[str, Grabber],
    recordings: Mapping[str, SideRecording],
    series: int,
) -> _PulseCount:
    """Fire all series, unless an event ends the run. Raises DeviceError, BringupError."""
    rig, clock = workplace.rig, workplace.wires.clock
    timeouts = Timeouts(rig.projector.refresh_hz)
    for side, grabber in grabbers.items():
        if not grabber.wait(recordings[side], "ready", timeouts.ready_s):
            raise BringupError(f"camera.{side} did not start within {timeouts.ready_s:g} s; run `kingfisher check`")
    pulse_count = _PulseCount()
    exposure_us = round(1000.0 * rig.camera.left.exposure_ms)
    series_s = PULSES / rig.projector.refresh_hz + timeouts.margin_s
    for number in range(series):
        workplace.say("endurance", number / series)
        board.arm(PULSES, board.vsync().count + LEAD_SYNCS, rig.board.trigger_delay_us, exposure_us)
        pulse_count.requested += PULSES
        until_ns = clock.now_ns() + int(series_s * 1e9)
        while not pulse_count.take(board.next_event(timeouts.pulse_s)):
            if clock.now_ns() > until_ns:
                pulse_count.ended_by = "the board did not report the end of the run"
                break
        # A board may report the end at the rising edge of its last pulse, and is busy until that has ended.
        clock.sleep_s(exposure_us / 1e6 + 0.001)
        # The first bad frame ends a recording; more pulses would count against a camera that no longer listens.
        broken = next(
            (side for side, recording in recordings.items() if recording.done and not recording.complete), None
        )
        if broken is not None and pulse_count.ended_by is None and number < series - 1:
            pulse_count.ended_by = f"camera.{broken}"
        if pulse_count.ended_by is not None:
            break
    else:
        for side, grabber in grabbers.items():
            grabber.wait(recordings[side], "done", timeouts.collect_s)
    return pulse_count


def _end(grabbers: Mapping[str, Grabber], recordings: Mapping[str, SideRecording], timeouts: Timeouts) -> None:
    for side, recording in recordings.items():
        if not recording.done:
            grabbers[side].cancel(recording)
            grabbers[side].wait(recording, "done", timeouts.collect_s)


def _camera_endurance(recording: SideRecording) -> CameraEndurance:
    """Return the statistics of one camera's frames."""
    complete = [frame for frame in recording.frames if frame.status is FrameStatus.COMPLETE]
    ids = [frame.block_id for frame in complete if frame.block_id is not None]
    # A cancelled recording ends with a frame that timed out, which is no fault of this camera.
    bad = [frame.status.value for frame in recording.frames if frame.status is not FrameStatus.COMPLETE]
    if recording.cancelled and bad and recording.frames[-1].status is FrameStatus.TIMEOUT:
        bad.pop()
    return CameraEndurance(
        complete=len(complete),
        bad=tuple(bad),
        without_stamp=sum(frame.camera_time_ns is None for frame in complete),
        gaps=sum(after - before != 1 for before, after in pairwise(ids)),
        lost=recording.lost,
    )


def _temperatures(grabbers: Mapping[str, Grabber], board: Board, clock: Clock) -> dict[str, float | None]:
    """Return temperatures by place, from idle cameras and the board's next heartbeat."""
    latest: Telemetry | None = None
    until_ns = clock.now_ns() + int(IDLE_S * 1e9)
    for _ in range(MOST_EVENTS):
        event = board.next_event(IDLE_S / 4.0)
        latest = event if isinstance(event, Telemetry) else latest
        if clock.now_ns() > until_ns and (latest is not None or event is None):
            break
    places: dict[str, float | None] = {
        "projector": None if latest is None else latest.temperature_projector_c,
        "case": None if latest is None else latest.temperature_case_c,
        "board": None if latest is None else latest.temperature_board_c,
    }
    return {**places, **{f"camera.{side}": grabber.temperature_c for side, grabber in grabbers.items()}}


def _lost_reports(board: Board) -> int:
    return board.counters.lost_reports if isinstance(board, TriggerBoard) else 0


def judge_endurance(run: EnduranceRun, warm_c: Mapping[str, float]) -> tuple[Finding, ...]:
    """Judge an endurance run; ``warm_c`` has the rig file's limits by place, other places have none."""
    cameras = (_side(side, value, run.pulses) for side, value in run.cameras.items())
    warmth = (_warmth(place, run.before_c.get(place), value, warm_c.get(place)) for place, value in run.after_c.items())
    return (_whole(run), _board(run), *cameras, *warmth)


def _whole(run: EnduranceRun) -> Finding:
    ended = "" if run.ended_by is None else f"; ended by: {run.ended_by}"
    statement, limits = f"{run.minutes:.2g} minutes, {run.pulses} pulses{ended}", f"{run.wanted_minutes:g} minutes"
    remedy = "see the findings below"
    return finding_of("run", not ended, statement, limits, remedy, minutes=run.minutes, frames=run.pulses)


def _board(run: EnduranceRun) -> Finding:
    ok = run.reported == run.pulses and run.lost_reports == 0
    statement = f"the board reported {run.reported} of {run.pulses} pulses; {run.lost_reports} of its reports were lost"
    remedy = "give the board a USB port of its own; look for vertical syncs that are missed when it is warm"
    numbers: dict[str, float] = {"reported": run.reported, "lost_reports": run.lost_reports}
    return finding_of("pulses", ok, statement, "each pulse reported, no report lost", remedy, **numbers)


def _side(side: str, camera: CameraEndurance, pulses: int) -> Finding:
    limits = "a complete frame with a time stamp for each pulse"
    statement, remedy = f"{camera.complete} complete frames of {pulses} pulses", ""
    # A lost camera also lacks frames: report the cause, not the effect.
    if camera.lost is not None:
        statement += f"; the camera was lost: {camera.lost}"
        remedy = "check its cable and supply; see the kernel's log for USB resets (dmesg)"
    elif camera.bad:
        counts = ", ".join(f"{word} ({camera.bad.count(word)}x)" for word in dict.fromkeys(camera.bad))
        statement += f"; {len(camera.bad)} arrived {counts}"
        remedy = (
            "connect each camera to its own USB controller; set usbcore.usbfs_memory_mb = 1000; end other "
            "work of the computer; set DeviceLinkThroughputLimit below the port's speed"
        )
    # Block ids distinguish a frame lost on the way from a pulse without a frame; a cable may be the cause of both.
    elif camera.gaps or camera.complete != pulses:
        statement += f", with {camera.gaps} gaps"
        remedy = "use another cable or port, if frames are lost on the link; see step trigger, if a trigger is missed"
    elif 0 < camera.without_stamp < camera.complete:
        statement += f"; {camera.without_stamp} without a time stamp"
        remedy = "update the camera's firmware"
    numbers = {
        "whole": camera.complete,
        "not_whole": len(camera.bad),
        "without_stamp": camera.without_stamp,
        "gaps": camera.gaps,
    }
    return finding_of(f"camera.{side}", not remedy, statement, limits, remedy, **numbers)


def _warmth(place: str, before_c: float | None, after_c: float | None, limit_c: float | None) -> Finding:
    if after_c is None:
        return Finding(f"warmth.{place}", True, "has no thermometer that answers")
    statement = f"{after_c:.1f} °C after the run" + ("" if before_c is None else f" (from {before_c:.1f} °C)")
    limits, ok = ("", True) if limit_c is None else (f"below {limit_c:g} °C, in air", after_c < limit_c)
    remedy = "lead its heat to the housing (pads, copper), or limit the lamp; in water it is cooler"
    return finding_of(f"warmth.{place}", ok, statement, limits, remedy, before_c=before_c, after_c=after_c)
