"""Owns the step ``endurance``: for minutes at the projector's rate, every pulse is a frame, every frame whole and
stamped, nothing too warm.

The board fires 64 reported pulses, is armed anew, and so on; the cameras stream through all of it. Frames are written
over each other in one slot: how many there are would fill any memory, and what they show is of no interest.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from appliance.instrument import Devices, Grabber, SideRecording, Timeouts, opened
from appliance.workshop.finding import BringupError, Finding, judged
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
"""Syncs between arming and the first pulse: time for the answer to travel."""
IDLE_S = 1.5
"""Time in which a camera that is idle has told its temperature, and the board its heartbeat."""
MOST_EVENTS = 400


@dataclass(frozen=True, slots=True)
class SideEndured:
    """One camera's part in an endurance run."""

    whole: int
    """Frames that arrived whole."""
    bad: tuple[str, ...]
    """The driver's words about those that did not, one each."""
    without_stamp: int
    """Whole frames without a time by the camera's clock."""
    gaps: int
    """Places at which block ids do not grow by one."""
    lost: str | None = None
    """Reason why the camera was lost; ``None``: it was not."""


@dataclass(frozen=True, slots=True)
class Endured:
    """Everything that was seen of an endurance run."""

    minutes: float
    """Length of the run, as it was."""
    wanted_minutes: float
    pulses: int
    """Pulses that were asked for."""
    reported: int
    """Pulses that the board reported."""
    lost_reports: int
    cameras: Mapping[str, SideEndured]
    before_c: Mapping[str, float | None]
    """Temperatures by place before the run; ``None``: not known."""
    after_c: Mapping[str, float | None]
    ended_by: str | None = None
    """Event that ended the run before its time; ``None``: none did."""


@dataclass(slots=True)
class _Fired:
    """Counts of the board's part."""

    asked: int = 0
    reported: int = 0
    ended_by: str | None = None
    latest: Telemetry | None = field(default=None)

    def take(self, event: BoardEvent | None) -> bool:
        """Take note of an event; True where the series is over."""
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


def do(at: Workplace) -> StepOutcome:
    """Do the step. Raises DeviceError, BringupError."""
    rig = at.rig
    black = np.zeros((rig.projector.height_px, rig.projector.width_px), np.uint8)

    def load(projector: Projector) -> None:
        projector.load([black])
        projector.show(0)

    with Devices(rig, at.wires, load) as devices:
        grabbers, board, _ = opened(devices, at.wires.clock)
        endured = _endure(at, grabbers, board)
    warm_c = {"projector": rig.limits.projector_warm_c, "case": rig.limits.case_warm_c}
    return StepOutcome(judge_endurance(endured, warm_c))


def _endure(at: Workplace, grabbers: Mapping[str, Grabber], board: Board) -> Endured:
    """Do the run. Raises DeviceError, BringupError."""
    rig, clock = at.rig, at.wires.clock
    series = max(1, round(60.0 * at.minutes * rig.projector.refresh_hz / PULSES))
    # Cold, before the cameras stream: warmth is told by how much it grew.
    before_c = _temperatures(grabbers, board, clock)
    lost_before = _lost_reports(board)
    slots = _one_slot(rig.camera.left.height_px, rig.camera.left.width_px, PULSES * series)
    recordings = {side: grabber.record(slots[side], lambda _index: None) for side, grabber in grabbers.items()}
    # From here on the cameras wait for pulses: whatever happens, they are let go.
    begun_ns = clock.now_ns()
    try:
        seen = _fire(at, board, grabbers, recordings, series)
        passed_s = (clock.now_ns() - begun_ns) / 1e9
    finally:
        with suppress(DeviceError):
            board.stop()
        _end(grabbers, recordings, Timeouts(rig.projector.refresh_hz))
    return Endured(
        minutes=passed_s / 60.0,
        wanted_minutes=at.minutes,
        pulses=seen.asked,
        reported=seen.reported,
        lost_reports=_lost_reports(board) - lost_before,
        cameras={side: _endured(one) for side, one in recordings.items()},
        before_c=before_c,
        after_c=_temperatures(grabbers, board, clock),
        ended_by=seen.ended_by,
    )


def _one_slot(height_px: int, width_px: int, count: int) -> dict[str, NDArray[np.uint8]]:
    """Return ``count`` images (count, h, w) for each camera that all lie in the same memory."""
    found = {}
    for side in ("left", "right"):
        image = np.zeros((height_px, width_px), np.uint8)
        found[side] = as_strided(image, (count, height_px, width_px), (0, *image.strides), writeable=True)
    return found


def _fire(
    at: Workplace,
    board: Board,
    grabbers: Mapping[str, Grabber],
    recordings: Mapping[str, SideRecording],
    series: int,
) -> _Fired:
    """Fire series after series until all are done, or something ends it. Raises DeviceError, BringupError."""
    rig, clock = at.rig, at.wires.clock
    timeouts = Timeouts(rig.projector.refresh_hz)
    for side, grabber in grabbers.items():
        if not grabber.wait(recordings[side], "ready", timeouts.ready_s):
            raise BringupError(f"camera.{side} did not start within {timeouts.ready_s:g} s; ask `kingfisher check`")
    fired = _Fired()
    exposure_us = round(1000.0 * rig.camera.left.exposure_ms)
    series_s = PULSES / rig.projector.refresh_hz + timeouts.margin_s
    for number in range(series):
        at.say("endurance", number / series)
        board.arm(PULSES, board.vsync().count + LEAD_SYNCS, rig.board.trigger_delay_us, exposure_us)
        fired.asked += PULSES
        until_ns = clock.now_ns() + int(series_s * 1e9)
        while not fired.take(board.next_event(timeouts.pulse_s)):
            if clock.now_ns() > until_ns:
                fired.ended_by = "the board did not say that it was done"
                break
        # A board may say so with its last pulse's rising edge: until that has ended it is busy.
        clock.sleep_s(exposure_us / 1e6 + 0.001)
        # The first bad frame ends a recording; more pulses would count against a camera that no longer listens.
        broken = next((side for side, one in recordings.items() if one.done and not one.complete), None)
        if broken is not None and fired.ended_by is None and number < series - 1:
            fired.ended_by = f"camera.{broken}"
        if fired.ended_by is not None:
            break
    else:
        for side, grabber in grabbers.items():
            grabber.wait(recordings[side], "done", timeouts.collect_s)
    return fired


def _end(grabbers: Mapping[str, Grabber], recordings: Mapping[str, SideRecording], timeouts: Timeouts) -> None:
    for side, recording in recordings.items():
        if not recording.done:
            grabbers[side].cancel(recording)
            grabbers[side].wait(recording, "done", timeouts.collect_s)


def _endured(recording: SideRecording) -> SideEndured:
    """Return what became of one camera's frames."""
    whole = [one for one in recording.frames if one.status is FrameStatus.COMPLETE]
    ids = [one.block_id for one in whole if one.block_id is not None]
    # A recording that was ended from outside closes with a frame that never came: no fault of this camera.
    bad = [one.status.value for one in recording.frames if one.status is not FrameStatus.COMPLETE]
    if recording.cancelled and bad and recording.frames[-1].status is FrameStatus.TIMEOUT:
        bad.pop()
    return SideEndured(
        whole=len(whole),
        bad=tuple(bad),
        without_stamp=sum(one.camera_time_ns is None for one in whole),
        gaps=sum(after - before != 1 for before, after in pairwise(ids)),
        lost=recording.lost,
    )


def _temperatures(grabbers: Mapping[str, Grabber], board: Board, clock: Clock) -> dict[str, float | None]:
    """Return temperatures by place, as cameras that are idle and the board's next heartbeat have them."""
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


def judge_endurance(seen: Endured, warm_c: Mapping[str, float]) -> tuple[Finding, ...]:
    """Judge an endurance run; ``warm_c`` are the rig file's limits by place, others have none."""
    cameras = (_side(side, one, seen.pulses) for side, one in seen.cameras.items())
    warmth = (_warmth(place, seen.before_c.get(place), one, warm_c.get(place)) for place, one in seen.after_c.items())
    return (_whole(seen), _board(seen), *cameras, *warmth)


def _whole(seen: Endured) -> Finding:
    ended = "" if seen.ended_by is None else f"; ended by: {seen.ended_by}"
    said, limits = f"{seen.minutes:.2g} minutes, {seen.pulses} pulses{ended}", f"{seen.wanted_minutes:g} minutes"
    remedy = "the findings below say of what"
    return judged("run", not ended, said, limits, remedy, minutes=seen.minutes, frames=seen.pulses)


def _board(seen: Endured) -> Finding:
    ok = seen.reported == seen.pulses and seen.lost_reports == 0
    said = f"the board reported {seen.reported} of {seen.pulses} pulses; {seen.lost_reports} of its reports were lost"
    remedy = "give the board a USB port of its own; look for vertical syncs that are missed when it is warm"
    numbers: dict[str, float] = {"reported": seen.reported, "lost_reports": seen.lost_reports}
    return judged("pulses", ok, said, "each pulse reported, no report lost", remedy, **numbers)


def _side(side: str, one: SideEndured, pulses: int) -> Finding:
    limits = "a whole frame with a stamp for each pulse"
    said, remedy = f"{one.whole} whole frames of {pulses} pulses", ""
    # A camera that is gone lacks frames, too: the cause is told, not the effect.
    if one.lost is not None:
        said += f"; the camera was lost: {one.lost}"
        remedy = "check its cable and supply; see the kernel's log for USB resets (dmesg)"
    elif one.bad:
        counts = ", ".join(f"{word} ({one.bad.count(word)}x)" for word in dict.fromkeys(one.bad))
        said += f"; {len(one.bad)} arrived {counts}"
        remedy = (
            "both cameras on USB controllers of their own; usbcore.usbfs_memory_mb = 1000; no other work on the "
            "computer; "
            "DeviceLinkThroughputLimit below the port's speed"
        )
    # Ids tell a frame that was lost on the way from a pulse that made none; both want another cable first.
    elif one.gaps or one.whole != pulses:
        said += f", with {one.gaps} gaps"
        remedy = (
            "frames are lost between camera and computer: another cable or port; a trigger is missed: see step trigger"
        )
    elif 0 < one.without_stamp < one.whole:
        said += f"; {one.without_stamp} without a time"
        remedy = "update the camera's firmware"
    numbers = {"whole": one.whole, "not_whole": len(one.bad), "without_stamp": one.without_stamp, "gaps": one.gaps}
    return judged(f"camera.{side}", not remedy, said, limits, remedy, **numbers)


def _warmth(place: str, before_c: float | None, after_c: float | None, most_c: float | None) -> Finding:
    if after_c is None:
        return Finding(f"warmth.{place}", True, "has no thermometer that answers")
    said = f"{after_c:.1f} °C after the run" + ("" if before_c is None else f" (from {before_c:.1f} °C)")
    limits, ok = ("", True) if most_c is None else (f"below {most_c:g} °C, in air", after_c < most_c)
    remedy = "lead its heat to the housing (pads, copper), or limit the lamp; in water it is cooler"
    return judged(f"warmth.{place}", ok, said, limits, remedy, before_c=before_c, after_c=after_c)
