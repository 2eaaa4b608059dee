"""Comparison of the four witnesses of a sequence: flips, pulses, left frames, right frames.

    Ledger, audit          records of the witnesses, and their first disagreement
    SyncMap, map_vsync     which of the board's vsyncs is which flip of the projector, between three clocks
    agreed_frames, …       number of frames on which all agree, and faults of one side alone

Each witness alone can be fooled; together they cannot: a late flip, a missing pulse, and a frame that is lost, doubled,
swapped or cut all make two of them disagree. Any disagreement is a named fault. Nothing is interpolated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

from appliance.measure import Fault, FaultCode
from drivers.api import Board, ClockReading, Flip, Frame, FrameStatus, Pulse, Vsync

MAX_PHASE_ERROR = 0.3
"""Largest difference, in periods, between the times of a vsync by the board and by the kernel."""
MAX_QUERIES = 10


class SyncError(Exception):
    """The board's vsync does not follow the projector's; the text gives the difference."""


@dataclass(frozen=True, slots=True)
class SyncMap:
    """Board vsync ``count`` is the blank of ``flip``; board time converts to host time around it."""

    flip: Flip
    count: int
    host_minus_board_ns: int
    phase_error: float
    """Board's vsync minus the kernel's flip time, in periods."""

    def host_ns(self, board_time_us: int) -> int:
        """Return the host time of a board time near the query.

        A clock drift of 50 ppm makes 25 µs in half a second.
        """
        return board_time_us * 1000 + self.host_minus_board_ns


def map_vsync(flip: Flip, vsync: Vsync, period_ns: float) -> SyncMap | None:
    """Return the map from one query; ``None`` if the query took too long or the phase does not fit."""
    # The board read its clock at some time within the query: the error of the middle is half of it, here a quarter of
    # a period, of which 0.3 are allowed.
    if vsync.host_received_ns - vsync.host_sent_ns > 0.5 * period_ns:
        return None
    middle_ns = (vsync.host_sent_ns + vsync.host_received_ns) // 2
    host_minus_board_ns = middle_ns - vsync.board_now_us * 1000
    blanks = (vsync.board_time_us * 1000 + host_minus_board_ns - flip.time_ns) / period_ns
    blank_count = round(blanks)
    if abs(blanks - blank_count) > MAX_PHASE_ERROR:
        return None
    return SyncMap(flip, vsync.count - blank_count, host_minus_board_ns, blanks - blank_count)


def synchronise(board: Board, flip: Flip, period_ns: float) -> SyncMap:
    """Ask the board until two queries agree (at most ten). Raises SyncError, and the board's DeviceError."""
    counts: list[int] = []
    for _ in range(MAX_QUERIES):
        sync = map_vsync(flip, board.vsync(), period_ns)
        if sync is not None:
            # Any two of the ten may agree: a late answer may be wrong by a whole period, but hardly twice by the same.
            if sync.count in counts:
                return sync
            counts.append(sync.count)
    raise SyncError(
        f"{MAX_QUERIES} queries gave the vertical sync numbers {counts} for one flip; two must agree; "
        "check the board's tap of the projector's video"
    )


MAX_SKEW_NS = 200_000
"""Largest difference of exposure starts of left and right, and of frame and pulse, in a short sequence."""
CLOCKS_PPM = 200.0
"""Rate by which two clocks of 100 ppm each may drift apart; in long sequences it exceeds MAX_SKEW_NS."""
MAX_APART_NS = 500_000
"""Largest difference of the first exposures by the host's clock, beyond the error of reading the cameras' clocks."""
LEAST_REGULAR = 3
"""Least number of frames whose intervals can be compared."""
MAX_FLIP_PHASE = 0.4
"""Pulse minus flip minus trigger delay, in periods."""


@dataclass(frozen=True, slots=True)
class Ledger:
    """Records of the four witnesses. Flips and pulses are in order of arrival; ``frames`` by side."""

    expected: int
    period_ns: float
    start_sequence: int | None
    """Vertical-blank number planned for the first pattern; ``None`` where the display has no counter."""
    start_vsync: int | None
    """The board's number of the first pattern's vsync; ``None`` if the board was never armed."""
    delay_us: int
    flips: tuple[Flip, ...]
    pulses: tuple[Pulse, ...]
    frames: Mapping[str, tuple[Frame, ...]]
    sync: SyncMap | None
    clocks: Mapping[str, ClockReading] = field(default_factory=dict, hash=False)
    """The cameras' clocks as read before the sequence; a camera without readable clock is missing."""
    latency_blanks: int = 0
    """Blanks from a flip to its light, as the rig file states them."""

    def as_dict(self) -> dict[str, Any]:
        """Return the ledger JSON-ready, for the manifest."""
        return {
            "expected": self.expected,
            "period_ns": self.period_ns,
            "start_sequence": self.start_sequence,
            "start_vsync": self.start_vsync,
            "trigger_delay_us": self.delay_us,
            "latency_blanks": self.latency_blanks,
            "flips": [{"sequence": f.sequence, "time_ns": f.time_ns} for f in self.flips],
            "pulses": [{"index": p.index, "vsync": p.vsync, "board_time_us": p.board_time_us} for p in self.pulses],
            "frames": {
                side: [
                    {
                        "status": f.status.value,
                        "block_id": f.block_id,
                        "camera_time_ns": f.camera_time_ns,
                        "received_ns": f.received_ns,
                    }
                    for f in frames
                ]
                for side, frames in self.frames.items()
            },
            "clocks": {
                side: {
                    "camera_time_ns": clock.camera_time_ns,
                    "host_sent_ns": clock.host_sent_ns,
                    "host_received_ns": clock.host_received_ns,
                }
                for side, clock in self.clocks.items()
            },
        }


def audit(ledger: Ledger) -> Fault | None:
    """Return the first disagreement of the witnesses, causes before effects; ``None`` if all agree."""
    return (
        # In the order of cause and effect: a late flip delays all that follow, a missing pulse takes a frame from both
        # cameras, a missing frame concerns one. Times are compared once all counts agree: the lists have equal lengths.
        _flips(ledger)
        or _pulses(ledger)
        or frame_fault(ledger, "left")
        or frame_fault(ledger, "right")
        or _flips_against_pulses(ledger)
        or _times(ledger)
        or _apart(ledger)
    )


def agreed_frames(ledger: Ledger) -> int:
    """Return the number of first frames on which all four witnesses agree; 0 for none.

    The rest of the sequence may have ended in any way.
    """
    largest_count = min(
        len(ledger.flips), len(ledger.pulses), *(len(frames) for frames in ledger.frames.values()), ledger.expected
    )
    for count in range(largest_count, 0, -1):
        # Audited as a shorter sequence: later frames cannot make an earlier one right.
        shortened = replace(
            ledger,
            expected=count,
            flips=ledger.flips[:count],
            pulses=ledger.pulses[:count],
            frames={side: frames[:count] for side, frames in ledger.frames.items()},
        )
        if audit(shortened) is None:
            return count
    return 0


def _flips(ledger: Ledger) -> Fault | None:
    for k, flip in enumerate(ledger.flips):
        # Vertical blanks by the kernel's count; without one, the time between flips in periods.
        if flip.sequence is not None and ledger.start_sequence is not None:
            late = flip.sequence - (ledger.start_sequence + k)
        elif k > 0:
            late = round((flip.time_ns - ledger.flips[k - 1].time_ns) / ledger.period_ns) - 1
        else:
            late = 0
        if late != 0:
            return Fault(
                FaultCode.LATE_FLIP,
                f"pattern {k} reached the screen {late} vertical blanks late",
                {"frame": k, "late_blanks": late},
                "projector",
            )
    if len(ledger.flips) != ledger.expected:
        return Fault(
            FaultCode.LATE_FLIP,
            f"{len(ledger.flips)} of {ledger.expected} patterns reached the screen",
            {"frame": len(ledger.flips), "received": len(ledger.flips), "expected": ledger.expected},
            "projector",
        )
    return None


def _pulses(ledger: Ledger) -> Fault | None:
    numbers = {"received": float(len(ledger.pulses)), "expected": float(ledger.expected)}
    if [p.index for p in ledger.pulses] != list(range(ledger.expected)):
        return Fault(
            FaultCode.PULSE_MISSING,
            f"the board reported pulses {_ranges([p.index for p in ledger.pulses])} of {ledger.expected}",
            numbers,
            "board",
        )
    for p in ledger.pulses:
        if ledger.start_vsync is None or p.vsync != ledger.start_vsync + p.index:
            return Fault(
                FaultCode.SYNC_LOST,  # all pulses came: "PULSES 24/24" would be no reason
                f"pulse {p.index} was fired on vertical sync {p.vsync}, not {(ledger.start_vsync or 0) + p.index}",
                {"frame": p.index},
                "board",
            )
    return None


def frame_fault(ledger: Ledger, side: str) -> Fault | None:
    """Return the fault of one side's frames by themselves."""
    device = f"camera.{side}"
    frames = ledger.frames.get(side, ())
    for k, frame in enumerate(frames):
        code = _STATUS_FAULT[frame.status]
        if code is not None and frame.status is not FrameStatus.TIMEOUT:
            return Fault(
                code,
                f"{device}: frame {k} arrived {frame.status.value} ({frame.detail})",
                {"frame": k, "received": k, "expected": ledger.expected},
                device,
            )
    # After the driver's own status come repetition, order, and number, by the cameras' block ids.
    arrived = [f for f in frames if f.status is FrameStatus.COMPLETE]
    ids = [f.block_id for f in arrived if f.block_id is not None]
    for k in range(1, len(ids)):
        # Block ids grow by one with each frame (USB3 Vision): repeated, falling and jumping ids are three different
        # faults.
        if ids[k] in ids[:k]:
            return Fault(
                FaultCode.FRAME_REPEATED, f"{device}: block {ids[k]} arrived again as frame {k}", {"frame": k}, device
            )
    for k in range(1, len(ids)):
        if ids[k] < ids[k - 1]:
            return Fault(
                FaultCode.FRAME_ORDER,
                f"{device}: block {ids[k]} arrived after block {ids[k - 1]}",
                {"frame": k},
                device,
            )
    if len(arrived) != ledger.expected or len(ids) != len(arrived) or ids[-1] - ids[0] != len(ids) - 1:
        return _missing(ledger, side, arrived)
    return None


def _missing(ledger: Ledger, side: str, arrived: Sequence[Frame]) -> Fault:
    """Return the fault of missing frames: all, all but each n-th, or some.

    The first two are systematic and come again.
    """
    device = f"camera.{side}"
    summary = f"{device}: {len(arrived)} of {ledger.expected} frames arrived"
    where = _first_gap(ledger, side, arrived) if arrived else 0
    numbers = {"frame": where, "received": min(len(arrived), ledger.expected - 1), "expected": ledger.expected}
    every = _every(ledger, arrived)
    # These two are due to settings or wiring: repeating the scan does not help.
    if len(ledger.pulses) == ledger.expected and not arrived:
        remedy = "check the trigger cable and trigger_source of this camera"
        return Fault(FaultCode.CAMERA_SILENT, f"{summary} of as many pulses; {remedy}", numbers, device)
    if every is not None:
        remedy = "exposure and readout do not overlap, or frame rate or throughput is limited: check its features"
        summary = f"{summary}, one for every {every} pulses; {remedy}"
        return Fault(FaultCode.CAMERA_TOO_SLOW, summary, {**numbers, "every": every}, device)
    return Fault(FaultCode.FRAME_MISSING, f"{summary}; the first gap is at frame {where}", numbers, device)


def _every(ledger: Ledger, arrived: Sequence[Frame]) -> int | None:
    """Return the number of pulses for each of a camera's frames, by its clock; ``None`` if irregular.

    A camera that is still busy ignores a pulse, and takes the next one after it is ready.
    """
    times_ns = [frame.camera_time_ns for frame in arrived if frame.camera_time_ns is not None]
    if len(times_ns) < LEAST_REGULAR:
        return None
    # Block ids do not show it: an ignored pulse has none.
    steps = {round((after - before) / ledger.period_ns) for before, after in pairwise(times_ns)}
    every = min(steps)
    return every if len(steps) == 1 and every > 1 and len(arrived) == -(-ledger.expected // every) else None


def _first_gap(ledger: Ledger, side: str, arrived: Sequence[Frame]) -> int:
    """Return the index of the first missing frame of one side, by block ids and by the camera's clock.

    A camera that missed a pulse has no gap in its ids, but one in its clock.
    """
    late = _begins_late(ledger, side)
    for k, frame in enumerate(arrived):
        # A frame lost in transfer leaves a gap in the ids; a missed pulse leaves one only in the clock.
        by_id = by_clock = k
        if frame.block_id is not None and arrived[0].block_id is not None:
            by_id = frame.block_id - arrived[0].block_id + late
        if frame.camera_time_ns is not None and arrived[0].camera_time_ns is not None:
            by_clock = round((frame.camera_time_ns - arrived[0].camera_time_ns) / ledger.period_ns) + late
        if max(by_id, by_clock) > k:
            return k
    return len(arrived)


def _begins_late(ledger: Ledger, side: str) -> int:
    """Return the number of first frames that one side lacks and the other one has.

    By the host's clock; if the cameras' clocks cannot be read, by block ids, which begin alike, since both cameras are
    started again for every sequence.
    """
    begun_ns = _start_times_ns(ledger)
    if len(begun_ns) == 2:
        # In periods: the uncertainty of a camera's clock reading is far less.
        return round((begun_ns[side] - min(begun_ns.values())) / ledger.period_ns)
    first_ids = {name: frames[0].block_id for name, frames in ledger.frames.items() if frames}
    block_ids = [block_id for block_id in first_ids.values() if block_id is not None]
    first_id = first_ids.get(side)
    return 0 if first_id is None else first_id - min(block_ids)


def _flips_against_pulses(ledger: Ledger) -> Fault | None:
    if ledger.sync is None:
        return Fault(FaultCode.SYNC_LOST, "the board's vertical sync is not matched to the projector's", {}, "board")
    for flip, pulse in zip(ledger.flips, ledger.pulses, strict=True):
        # Board time → host time by the matched vsyncs; then pulse minus flip minus the trigger delay and the
        # projector's latency is zero but for jitter.
        expected_ns = flip.time_ns + ledger.delay_us * 1000 + ledger.latency_blanks * ledger.period_ns
        after_ns = ledger.sync.host_ns(pulse.board_time_us) - expected_ns
        if abs(after_ns) > MAX_FLIP_PHASE * ledger.period_ns:
            return Fault(
                FaultCode.PROJECTOR_TIMING,
                f"pulse {pulse.index} came {after_ns / 1e6:.1f} ms off the time of its pattern's flip",
                {"frame": pulse.index, "shift_frames": round(after_ns / ledger.period_ns)},
                "projector",
            )
    return None


def _times(ledger: Ledger) -> Fault | None:
    """Return a fault if frames do not follow the pulses, or each other, in the cameras' own clocks.

    A clock's offset is free, its rate is within 100 ppm.
    """
    first_us = ledger.pulses[0].board_time_us
    relative: dict[str, list[int]] = {}
    for side, frames in ledger.frames.items():
        times = [f.camera_time_ns for f in frames]
        if any(t is None for t in times):
            continue  # a camera without time stamps; its ids have been checked
        # Relative to the first frame: a camera's clock starts anywhere.
        start = times[0] or 0
        relative[side] = [(t or 0) - start for t in times]
        for k, (dt, pulse) in enumerate(zip(relative[side], ledger.pulses, strict=True)):
            passed_ns = (pulse.board_time_us - first_us) * 1000
            skew_ns = dt - passed_ns
            if abs(skew_ns) > _wander_ns(MAX_SKEW_NS, passed_ns):
                return _skew(
                    f"camera.{side}: frame {k} was exposed {skew_ns / 1e6:.2f} ms off its pulse", k, skew_ns, side
                )
    if len(relative) == 2:
        for k, (left, right) in enumerate(zip(relative["left"], relative["right"], strict=True)):
            if abs(left - right) > _wander_ns(MAX_SKEW_NS, left):
                return _skew(
                    f"frame {k}: left and right are {(left - right) / 1e6:.2f} ms apart", k, left - right, "left"
                )
    return None


def _apart(ledger: Ledger) -> Fault | None:
    """Return a fault if one camera is late by the same time in every frame.

    Only the cameras' clocks against the host's show that. The two are compared with each other only: which moment of an
    exposure a time stamp means is the maker's choice, and they are alike.
    """
    begun_ns = _start_times_ns(ledger)
    if len(begun_ns) < 2:
        return None
    # The clocks were read before the sequence and drift from then on: their error grows with the wait.
    waited_ns = max(begun_ns[side] - clock.camera_time_ns - clock.offset_ns for side, clock in ledger.clocks.items())
    apart_ns = begun_ns["right"] - begun_ns["left"]
    if (
        abs(apart_ns)
        <= _wander_ns(MAX_APART_NS, waited_ns) + sum(clock.bracket_ns for clock in ledger.clocks.values()) // 2
    ):
        return None
    late = "right" if apart_ns > 0 else "left"
    return _skew(f"all frames of camera.{late} are exposed {abs(apart_ns) / 1e6:.2f} ms late", 0, abs(apart_ns), late)


def _start_times_ns(ledger: Ledger) -> dict[str, int]:
    """Return the host time of the first exposure of each side, as far as it is known."""
    begun_ns = {}
    for side, clock in ledger.clocks.items():
        frames = ledger.frames.get(side, ())
        if frames and frames[0].camera_time_ns is not None:
            begun_ns[side] = frames[0].camera_time_ns + clock.offset_ns
    return begun_ns


def _wander_ns(least_ns: int, passed_ns: int) -> float:
    """Return the largest difference that two clocks may gain in a time."""
    return max(least_ns, CLOCKS_PPM * 1e-6 * passed_ns)


def _skew(detail: str, frame: int, skew_ns: int, side: str) -> Fault:
    return Fault(FaultCode.SYNC_LOST, detail, {"frame": frame, "skew_ms": skew_ns / 1e6}, f"camera.{side}")


def _ranges(numbers: Sequence[int]) -> str:
    """Spell numbers like ``0-8, 10-23``."""
    parts: list[list[int]] = []
    for n in numbers:
        if parts and n == parts[-1][1] + 1:
            parts[-1][1] = n
        else:
            parts.append([n, n])
    return ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in parts) or "none"


_STATUS_FAULT: dict[FrameStatus, FaultCode | None] = {
    FrameStatus.COMPLETE: None,
    FrameStatus.TRUNCATED: FaultCode.FRAME_TRUNCATED,
    FrameStatus.CORRUPT: FaultCode.FRAME_CORRUPT,
    FrameStatus.WRONG_ID: FaultCode.FRAME_CORRUPT,
    FrameStatus.DISCARDED: FaultCode.FRAME_MISSING,
    FrameStatus.TIMEOUT: FaultCode.FRAME_MISSING,
}
