"""Four witnesses: any one that disagrees makes a named fault; clean sequences of any clock offset pass, and all is written down."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest

from appliance.instrument.capture.ledger import Ledger, agreed_frames, audit, frame_fault, map_vsync
from appliance.measure.fault import FaultCode
from drivers.api import ClockReading, Flip, Frame, FrameStatus, Pulse, Vsync
from tests.support.golden_texts import Says

N = 24
PERIOD_NS = 1e9 / 60
DELAY_US = 500
BOARD_START_US = 5_000_000
SIDES = ("left", "right")
C = FaultCode


def sequence(period_ns: float, left_ppm: float, right_ppm: float, clocks: dict[str, ClockReading]) -> Ledger:
    """All witnesses agree, but for the rates of the cameras' clocks."""
    flips = tuple(Flip(k, 1000 + k, int(7e9 + k * period_ns)) for k in range(N))
    vsync = Vsync(200, BOARD_START_US, BOARD_START_US + 1000, int(7e9 + 0.5e6), int(7e9 + 1.5e6))
    sync = map_vsync(flips[0], vsync, PERIOD_NS)
    pulses = tuple(Pulse(k, 200 + k, int(BOARD_START_US + DELAY_US + k * period_ns / 1000)) for k in range(N))
    frames = {
        side: tuple(
            Frame(FrameStatus.COMPLETE, 5 + k, int(at_ns + k * period_ns * (1 + ppm * 1e-6)), int(7e9 + k * period_ns))
            for k in range(N)
        )
        for side, at_ns, ppm in (("left", 10**12, left_ppm), ("right", 3, right_ppm))
    }
    return Ledger(N, period_ns, 1000, 200, DELAY_US, flips, pulses, frames, sync, clocks)


def clean() -> Ledger:
    """Both cameras begin their first exposure at 7.0005 s of the host."""
    clocks = {
        "left": ClockReading(10**12 - int(0.3e9), int(6.7005e9) - 100_000, int(6.7005e9) + 100_000),
        "right": ClockReading(3 - int(0.2e9), int(6.8005e9) - 300_000, int(6.8005e9) + 300_000),
    }
    return sequence(PERIOD_NS, 40, -40, clocks)


def with_frames(ledger: Ledger, side: str, frames: Sequence[Frame]) -> Ledger:
    return replace(ledger, frames={**ledger.frames, side: tuple(frames)})


def taken(side: str, which: Sequence[int], renumbered: bool = False) -> Ledger:
    frames = [clean().frames[side][k] for k in which]
    if renumbered:
        frames = [replace(f, block_id=5 + n) for n, f in enumerate(frames)]
    return with_frames(clean(), side, frames)


def without(*lost: int) -> list[int]:
    return [k for k in range(N) if k not in lost]


def swapped(k: int) -> list[int]:
    return [*range(k), k + 1, k, *range(k + 2, N)]


def damaged(side: str, k: int, status: FrameStatus) -> Ledger:
    return with_frames(clean(), side, [*clean().frames[side][:k], Frame(status, 5 + k, None, 0, "cut")])


def later(ledger: Ledger, side: str, by_us: float, which: Sequence[int] = range(N)) -> Ledger:
    by_ns = [round(by_us * 1000) if k in which else 0 for k in range(N)]
    frames = zip(ledger.frames[side], by_ns, strict=True)
    return with_frames(ledger, side, [replace(f, camera_time_ns=(f.camera_time_ns or 0) + ns) for f, ns in frames])


def unstamped(ledger: Ledger, *sides: str) -> Ledger:
    for side in sides:
        ledger = with_frames(ledger, side, [replace(f, camera_time_ns=None) for f in ledger.frames[side]])
    return replace(ledger, clocks={}) if len(sides) > 1 else ledger


def unnumbered(side: str, which: Sequence[int]) -> Ledger:
    frames = [replace(f, block_id=None) if k in which else f for k, f in enumerate(clean().frames[side])]
    return with_frames(clean(), side, frames)


def late_flips(k: int, blanks: int = 1, counted: bool = True) -> Ledger:
    def late(flip: Flip) -> Flip:
        by = blanks if flip.index >= k else 0
        if counted:
            return replace(flip, sequence=(flip.sequence or 0) + by)
        return replace(flip, sequence=None, time_ns=flip.time_ns + round(by * PERIOD_NS))

    return replace(clean(), flips=tuple(map(late, clean().flips)), start_sequence=1000 if counted else None)


def pulses_later(by_us: float, ledger: Ledger | None = None) -> Ledger:
    ledger = ledger or clean()
    pulses = tuple(replace(p, board_time_us=p.board_time_us + round(by_us)) for p in ledger.pulses)
    return replace(ledger, pulses=pulses)


def pulses(*lost: int) -> Ledger:
    return replace(clean(), pulses=tuple(p for p in clean().pulses if p.index not in lost))


def on_sync(k: int, off: int) -> Ledger:
    """Every time fits, only the board's own number of the blank does not."""
    moved = tuple(replace(p, vsync=p.vsync + off) if p.index == k else p for p in clean().pulses)
    return replace(clean(), pulses=moved)


def again(k: int) -> Ledger:
    frames = list(clean().frames["left"])
    frames[k] = replace(frames[k], block_id=frames[0].block_id)
    return with_frames(clean(), "left", frames)


ONE_MORE = Frame(FrameStatus.COMPLETE, 5 + N, None, 0)
SLOW_NS = 1e9
PERIOD_US = PERIOD_NS / 1000
EDGES = (0, 1, 9, N - 2, N - 1)
FAULTS: list[tuple[str, Ledger, FaultCode, str, dict[str, Any]]] = [
    # The frames.
    *((f"{side} lost frame {k} and the next but one", taken(side, without(k, k + 2)), C.FRAME_MISSING, side, {"frame": k, "expected": N})
      for side in SIDES for k in EDGES),
    *((f"{side} did not see pulse {k}", taken(side, without(k), True), C.FRAME_MISSING, side, {"frame": k, "received": N - 1})
      for side in SIDES for k in EDGES),
    *((f"without clocks frame {k} is missed by its number", unstamped(taken("left", without(k)), *SIDES), C.FRAME_MISSING, "left", {"frame": k})
      for k in EDGES),
    *((f"frame {k} came again", again(k), C.FRAME_REPEATED, "left", {"frame": k}) for k in EDGES[1:]),
    *((f"frame {k} came after the next", taken("right", swapped(k)), C.FRAME_ORDER, "right", {"frame": k + 1}) for k in EDGES[:-1]),
    ("truncated", damaged("left", 9, FrameStatus.TRUNCATED), C.FRAME_TRUNCATED, "left", {"frame": 9, "received": 9, "expected": N}),
    ("corrupt", damaged("right", 9, FrameStatus.CORRUPT), C.FRAME_CORRUPT, "right", {"frame": 9}),
    ("of another id", damaged("left", 9, FrameStatus.WRONG_ID), C.FRAME_CORRUPT, "left", {"frame": 9}),
    ("discarded", damaged("left", 9, FrameStatus.DISCARDED), C.FRAME_MISSING, "left", {"frame": 9}),
    ("one too many is not told as all", with_frames(clean(), "left", [*clean().frames["left"], ONE_MORE]), C.FRAME_MISSING, "left",
     {"received": N - 1, "expected": N}),
    *((f"without block ids at {which}", unnumbered("right", which), C.FRAME_MISSING, "right", {}) for which in (range(N), [N - 1], [0])),
    # The pace of a camera.
    ("not triggered", taken("right", []), C.CAMERA_SILENT, "right", {"received": 0}),
    *((f"each pulse of {every} from {first}", taken("right", range(first, N, every), True), C.CAMERA_TOO_SLOW, "right",
       {"every": every, "frame": 0 if first else 1}) for every in (2, 8) for first in (0, 1)),
    *((f"otherwise {which}", taken("right", which, True), C.FRAME_MISSING, "right", {})
      for which in ([0, 2, 4], [0, 2, 4, 6, 8, 11], [0, 23], list(range(23)), [*range(0, 11, 2), *range(13, 24, 2)])),
    ("without a clock nothing is said of its pace", unstamped(taken("right", range(0, N, 2), True), *SIDES), C.FRAME_MISSING, "right", {}),
    # When they were exposed.
    ("right is late in every frame", later(clean(), "right", 2000.0), C.SYNC_LOST, "right", {"skew_ms": pytest.approx(2.0, abs=0.01)}),
    ("left is, against it", later(clean(), "right", -2000.0), C.SYNC_LOST, "left", {"skew_ms": pytest.approx(2.0, abs=0.01)}),
    ("one frame is off its pulse", later(clean(), "right", 2000.0, [11]), C.SYNC_LOST, "right", {"skew_ms": pytest.approx(2.0, abs=0.05)}),
    *((f"each by less than it may, together more, at {k}", later(later(clean(), "left", 150.0, [k]), "right", -150.0, [k]), C.SYNC_LOST, "left",
       {"frame": k, "skew_ms": pytest.approx(0.3, abs=0.04)}) for k in (1, N - 1)),
    ("the other one has stamps", later(unstamped(clean(), "left"), "right", 3000.0, [3]), C.SYNC_LOST, "right", {"frame": 3}),
    ("a clock that wanders", sequence(SLOW_NS, 220.0, 220.0, {}), C.SYNC_LOST, "left", {}),
    ("two that wander apart", sequence(SLOW_NS, 110.0, -110.0, {}), C.SYNC_LOST, "left", {"frame": 1}),
    # The patterns.
    *((f"late from flip {k}", late_flips(k, blanks), C.LATE_FLIP, "projector", {"frame": k, "late_blanks": blanks})
      for k, blanks in ((0, 1), (7, 5), (N - 1, 1))),
    *((f"late from flip {k} without a counter", late_flips(k, blanks, False), C.LATE_FLIP, "projector", {"frame": k, "late_blanks": blanks})
      for k, blanks in ((1, 1), (7, 5), (N - 1, 1))),
    *((f"{n} never reached the screen", replace(clean(), flips=clean().flips[: N - n]), C.LATE_FLIP, "projector", {"received": N - n, "expected": N})
      for n in (1, N)),
    # The pulses.
    *((f"without pulses {lost}", pulses(*lost), C.PULSE_MISSING, "board", {"received": N - len(lost), "expected": N})
      for lost in ((0,), (9,), (N - 1,), tuple(range(N)))),
    *((f"{n} patterns away", pulses_later(n * PERIOD_US), C.PROJECTOR_TIMING, "projector", {"frame": 0, "shift_frames": n}) for n in (-2, -1, 1, 2)),
    *((f"{part} of a blank away", pulses_later(part * PERIOD_US), C.PROJECTOR_TIMING, "projector", {}) for part in (0.5, -0.5, 0.9)),
    ("they should have waited", replace(clean(), delay_us=10_000), C.PROJECTOR_TIMING, "projector", {}),
    *((f"pulse {k} on sync {off}", on_sync(k, off), C.SYNC_LOST, "board", {"frame": k}) for k in (0, 9, N - 1) for off in (-1, 1)),
    ("never armed", replace(clean(), start_vsync=None), C.SYNC_LOST, "board", {}),
    ("is not matched", replace(clean(), sync=None), C.SYNC_LOST, "board", {}),
]  # fmt: skip


@pytest.mark.parametrize(
    ("ledger", "code", "device", "numbers"), [pytest.param(*row, id=name) for name, *row in FAULTS]
)
def test_whoever_disagrees_is_named(ledger: Ledger, code: FaultCode, device: str, numbers: dict[str, Any]) -> None:
    fault = audit(ledger)
    assert fault is not None
    assert (fault.code, fault.device) == (code, f"camera.{device}" if device in SIDES else device)
    assert {name: fault.numbers[name] for name in numbers} == numbers


def vague(ledger: Ledger) -> Ledger:
    """A slow host must not accuse."""
    clocks = {side: replace(c, host_received_ns=c.host_received_ns + 4_000_000) for side, c in ledger.clocks.items()}
    return replace(ledger, clocks=clocks)


RIGHT_LATE = later(clean(), "right", 2000.0)
COUNTED = [replace(f, block_id=(f.block_id or 0) + 1) for f in clean().frames["right"]]


@pytest.mark.parametrize(
    "ledger",
    [
        clean(), vague(RIGHT_LATE), replace(RIGHT_LATE, clocks={}), later(clean(), "left", 150.0, [11]), unstamped(clean(), "left"),
        later(later(clean(), "left", 150.0, [11]), "right", 150.0, [11]), with_frames(clean(), "right", COUNTED),
        pulses_later(0.3 * PERIOD_US), pulses_later(-0.3 * PERIOD_US),
        *(pulses_later(delay_us - DELAY_US, replace(clean(), delay_us=delay_us)) for delay_us in (0, 15_000)),
        *(sequence(SLOW_NS, *ppm, {}) for ppm in ((190.0, 190.0), (-90.0, -90.0), (90.0, -90.0))),
    ],
)  # fmt: skip
def test_what_proves_nothing_accuses_nobody(ledger: Ledger) -> None:
    assert audit(ledger) is None


@pytest.mark.parametrize("side", SIDES)
def test_first_exposures_may_be_half_a_millisecond_apart_and_what_the_clocks_leave_open(side: str) -> None:
    """0.5 ms and half of the two answers' 0.2 and 0.6 ms; here to the nanosecond."""
    ledger = clean()
    begun = {one: (ledger.frames[one][0].camera_time_ns or 0) + clock.offset_ns for one, clock in ledger.clocks.items()}
    later_ns = begun["left" if side == "right" else "right"] - begun[side] + 500_000 + 400_000
    assert audit(later(ledger, side, later_ns / 1000)) is None
    fault = audit(later(ledger, side, (later_ns + 1) / 1000))
    assert fault is not None
    assert (fault.device, fault.numbers["frame"]) == (f"camera.{side}", 0)


def detail(ledger: Ledger) -> str:
    fault = audit(ledger)
    assert fault is not None
    return fault.detail


def test_each_kind_of_fault_says_what_was_seen(says: Says) -> None:
    one_of_each = {code: ledger for _, ledger, code, *_ in FAULTS}
    says("\n".join(f"{code.value}: {detail(ledger)}" for code, ledger in one_of_each.items()))
    ranges = {(9,): "0-8, 10-23", (0,): "1-23", (1,): "0, 2-23", (2, 3, 23): "0-1, 4-22", tuple(range(N)): "none"}
    assert all(said in detail(pulses(*missing)) for missing, said in ranges.items()), "pulses that came, as ranges"


def test_a_camera_that_sent_nothing_of_a_sequence_that_ended_early_is_not_called_silent() -> None:
    ledger = taken("right", [])
    fault = frame_fault(replace(ledger, pulses=ledger.pulses[:5]), "right")
    assert fault is not None
    assert fault.code is C.FRAME_MISSING


@pytest.mark.parametrize(
    ("ledger", "agreed"),
    [
        (clean(), N), *((taken(side, range(k)), k) for side in SIDES for k in (1, 14, 23)),
        *((taken("left", without(k)), k) for k in (1, 14, 22)),  # behind a lost one none is counted
        (damaged("right", 17, FrameStatus.TRUNCATED), 17), (late_flips(19), 19), (replace(clean(), flips=clean().flips[:16]), 16),
        (replace(clean(), pulses=clean().pulses[:15]), 15), (replace(clean(), flips=()), 0), (replace(clean(), sync=None), 0),
        (RIGHT_LATE, 0),
    ],
)  # fmt: skip
def test_so_many_of_the_first_frames_all_four_witnesses_agree_on(ledger: Ledger, agreed: int) -> None:
    assert agreed_frames(ledger) == agreed


def test_the_manifest_gets_every_number_of_the_four_witnesses() -> None:
    ledger = clean()
    said = json.loads(json.dumps(ledger.as_dict()))
    told = [said[name] for name in ("expected", "start_sequence", "start_vsync", "trigger_delay_us", "period_ns")]
    assert told == [N, 1000, 200, 500, PERIOD_NS]
    assert said["flips"][3] == {"sequence": 1003, "time_ns": ledger.flips[3].time_ns}
    assert said["pulses"][3] == {"index": 3, "vsync": 203, "board_time_us": ledger.pulses[3].board_time_us}
    frame, clock = ledger.frames["right"][3], ledger.clocks["left"]
    stamps = {"camera_time_ns": frame.camera_time_ns, "received_ns": frame.received_ns}
    assert said["frames"]["right"][3] == {"status": "complete", "block_id": 8, **stamps}
    names = ("camera_time_ns", "host_sent_ns", "host_received_ns")
    assert said["clocks"]["left"] == {name: getattr(clock, name) for name in names}
    assert [len(said["frames"][side]) for side in SIDES] == [N, N]
