"""Four witnesses: any one that disagrees makes a named fault; clean sequences of any clock offset pass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest

from appliance.capture.ledger import Ledger, audit
from appliance.capture.sync import map_vsync
from appliance.scan.fault import FaultCode
from drivers.api import ClockReading, Flip, Frame, FrameStatus, Pulse, Vsync

N = 24
PERIOD_NS = 1e9 / 60
DELAY_US = 500
BOARD_START_US = 5_000_000


def clean() -> Ledger:
    flips = tuple(Flip(k, 1000 + k, int(7e9 + k * PERIOD_NS)) for k in range(N))
    vsync = Vsync(200, BOARD_START_US, BOARD_START_US + 1000, int(7e9 + 0.5e6), int(7e9 + 1.5e6))
    sync = map_vsync(flips[0], vsync, PERIOD_NS)
    assert sync is not None
    pulses = tuple(Pulse(k, 200 + k, int(BOARD_START_US + DELAY_US + k * PERIOD_NS / 1000)) for k in range(N))

    def frames(offset_ns: int, ppm: float) -> tuple[Frame, ...]:
        return tuple(
            Frame(
                FrameStatus.COMPLETE, 5 + k, int(offset_ns + k * PERIOD_NS * (1 + ppm * 1e-6)), int(7e9 + k * PERIOD_NS)
            )
            for k in range(N)
        )

    # Both cameras begin their first exposure at 7.0005 s of the host.
    clocks = {
        "left": ClockReading(10**12 - int(0.3e9), int(6.7005e9) - 100_000, int(6.7005e9) + 100_000),
        "right": ClockReading(3 - int(0.2e9), int(6.8005e9) - 300_000, int(6.8005e9) + 300_000),
    }
    cameras = {"left": frames(10**12, 40), "right": frames(3, -40)}
    return Ledger(N, PERIOD_NS, 1000, 200, DELAY_US, flips, pulses, cameras, sync, clocks)


def with_frames(ledger: Ledger, side: str, frames: list[Frame]) -> Ledger:
    return replace(ledger, frames={**ledger.frames, side: tuple(frames)})


def test_a_clean_sequence_passes_whatever_the_clocks_offsets_are() -> None:
    assert audit(clean()) is None


@pytest.mark.parametrize(("late_ms", "device"), [(2.0, "camera.right"), (-2.0, "camera.left")])
def test_a_camera_that_is_late_by_the_same_time_in_every_frame(late_ms: float, device: str) -> None:
    ledger = clean()
    late = [replace(f, camera_time_ns=(f.camera_time_ns or 0) + int(late_ms * 1e6)) for f in ledger.frames["right"]]
    fault = audit(with_frames(ledger, "right", late))
    assert fault is not None
    assert (fault.code, fault.device) == (FaultCode.SYNC_LOST, device)
    assert fault.numbers["skew_ms"] == pytest.approx(2.0, abs=0.01)
    vague = {side: replace(c, host_received_ns=c.host_received_ns + 4_000_000) for side, c in ledger.clocks.items()}
    assert audit(with_frames(replace(ledger, clocks=vague), "right", late)) is None, "a slow host must not accuse"
    assert audit(with_frames(replace(ledger, clocks={}), "right", late)) is None, "not every camera has a clock to ask"


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize(("beyond_ns", "passes"), [(0, True), (1, False)])
def test_first_exposures_may_be_half_a_millisecond_apart_and_what_the_clocks_leave_open(
    side: str, beyond_ns: int, passes: bool
) -> None:
    """0.5 ms and half of the two answers' 0.2 and 0.6 ms; here to the nanosecond."""
    ledger = clean()
    begun = {one: (ledger.frames[one][0].camera_time_ns or 0) + clock.offset_ns for one, clock in ledger.clocks.items()}
    other = "left" if side == "right" else "right"
    later_ns = begun[other] - begun[side] + 500_000 + 400_000 + beyond_ns
    late = [replace(f, camera_time_ns=(f.camera_time_ns or 0) + later_ns) for f in ledger.frames[side]]
    fault = audit(with_frames(ledger, side, late))
    assert (fault is None) == passes
    if fault is not None:
        assert (fault.device, fault.numbers["frame"]) == (f"camera.{side}", 0)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("k", range(N))
def test_a_dropped_frame(side: str, k: int) -> None:
    frames = list(clean().frames[side])
    del frames[k]
    frames.append(Frame(FrameStatus.TIMEOUT, None, None, 0))
    fault = audit(with_frames(clean(), side, frames))
    assert fault is not None
    assert fault.code is FaultCode.FRAME_MISSING
    assert fault.numbers["received"] == N - 1
    assert fault.device == f"camera.{side}"


@pytest.mark.parametrize("k", range(N))
def test_a_repeated_frame(k: int) -> None:
    frames = list(clean().frames["left"])
    frames.insert(k, frames[k])
    fault = audit(with_frames(clean(), "left", frames[:N] if k < N - 1 else frames))
    assert fault is not None
    assert fault.code is FaultCode.FRAME_REPEATED


@pytest.mark.parametrize("k", range(N - 1))
def test_swapped_frames(k: int) -> None:
    frames = list(clean().frames["right"])
    frames[k], frames[k + 1] = frames[k + 1], frames[k]
    fault = audit(with_frames(clean(), "right", frames))
    assert fault is not None
    assert fault.code is FaultCode.FRAME_ORDER


@pytest.mark.parametrize(
    ("status", "code"),
    [
        (FrameStatus.TRUNCATED, FaultCode.FRAME_TRUNCATED),
        (FrameStatus.CORRUPT, FaultCode.FRAME_CORRUPT),
        (FrameStatus.WRONG_ID, FaultCode.FRAME_CORRUPT),
        (FrameStatus.DISCARDED, FaultCode.FRAME_MISSING),
    ],
)
def test_a_damaged_frame(status: FrameStatus, code: FaultCode) -> None:
    frames = [*clean().frames["left"][:9], Frame(status, 14, None, 0, "cut")]
    fault = audit(with_frames(clean(), "left", frames))
    assert fault is not None
    assert (fault.code, fault.numbers["frame"]) == (code, 9)


@pytest.mark.parametrize("k", range(N))
def test_a_late_flip(k: int) -> None:
    flips = [replace(f, sequence=(f.sequence or 0) + (1 if f.index >= k else 0)) for f in clean().flips]
    fault = audit(replace(clean(), flips=tuple(flips)))
    assert fault is not None
    assert (fault.code, fault.numbers["frame"]) == (FaultCode.LATE_FLIP, k)


@pytest.mark.parametrize("k", range(1, N))
def test_a_late_flip_without_a_blank_counter(k: int) -> None:
    flips = [
        replace(f, sequence=None, time_ns=f.time_ns + (int(PERIOD_NS) if f.index >= k else 0)) for f in clean().flips
    ]
    fault = audit(replace(clean(), flips=tuple(flips), start_sequence=None))
    assert fault is not None
    assert fault.code is FaultCode.LATE_FLIP


@pytest.mark.parametrize("k", range(N))
def test_a_missing_pulse(k: int) -> None:
    pulses = tuple(p for p in clean().pulses if p.index != k)
    fault = audit(replace(clean(), pulses=pulses))
    assert fault is not None
    assert fault.code is FaultCode.PULSE_MISSING


def test_pulses_a_blank_away_from_the_flips() -> None:
    flips = tuple(replace(f, time_ns=f.time_ns + int(PERIOD_NS)) for f in clean().flips)
    fault = audit(replace(clean(), flips=flips))
    assert fault is not None
    assert fault.code is FaultCode.PROJECTOR_TIMING


def test_a_frame_exposed_off_its_pulse() -> None:
    frames = list(clean().frames["right"])
    frames[11] = replace(frames[11], camera_time_ns=(frames[11].camera_time_ns or 0) + 2_000_000)
    fault = audit(with_frames(clean(), "right", frames))
    assert fault is not None
    assert fault.code is FaultCode.SYNC_LOST
    assert fault.numbers["skew_ms"] == pytest.approx(2.0, abs=0.05)


def test_a_slow_query_or_a_foreign_sync_supports_no_map() -> None:
    flip = Flip(-1, 10, int(7e9))
    assert map_vsync(flip, Vsync(9, 1000, 1000, int(7e9), int(7e9 + 9e6)), PERIOD_NS) is None, "took half a period"
    half_a_period_off = Vsync(9, 1000, 1000 + 8333, int(7e9 + 16.5e6), int(7e9 + 16.8e6))
    assert map_vsync(flip, half_a_period_off, PERIOD_NS) is None


@pytest.mark.parametrize("missing", [1, 2, N])
def test_patterns_that_never_reached_the_screen_are_named(missing: int) -> None:
    fault = audit(replace(clean(), flips=clean().flips[: N - missing]))
    assert fault is not None
    assert (fault.code, fault.device) == (FaultCode.LATE_FLIP, "projector")
    assert (fault.numbers["received"], fault.numbers["expected"]) == (N - missing, N)


@pytest.mark.parametrize("k", range(N))
@pytest.mark.parametrize("off", [-1, 1])
def test_a_pulse_on_the_wrong_vertical_sync(k: int, off: int) -> None:
    """Every time fits, only the board's own number of the blank does not: it has counted something else than blanks."""
    pulses = tuple(replace(p, vsync=p.vsync + off) if p.index == k else p for p in clean().pulses)
    fault = audit(replace(clean(), pulses=pulses))
    assert fault is not None
    assert (fault.code, fault.device, fault.numbers["frame"]) == (FaultCode.SYNC_LOST, "board", k)
    assert f"vertical sync {200 + k + off}, not {200 + k}" in fault.detail


def test_pulses_of_a_board_that_was_never_armed() -> None:
    fault = audit(replace(clean(), start_vsync=None))
    assert fault is not None
    assert fault.code is FaultCode.SYNC_LOST


@pytest.mark.parametrize(("late", "passes"), [(0.3, True), (-0.3, True), (0.5, False), (-0.5, False), (0.9, False)])
def test_pulses_part_of_a_blank_away_from_the_flips(late: float, passes: bool) -> None:
    """Half a blank of lateness lights half of one pattern and half of the next."""
    late_us = round(late * PERIOD_NS / 1000)
    pulses = tuple(replace(p, board_time_us=p.board_time_us + late_us) for p in clean().pulses)
    fault = audit(replace(clean(), pulses=pulses))
    assert (fault is None) == passes
    if fault is not None:
        assert fault.code is FaultCode.PROJECTOR_TIMING
        assert f"{late * PERIOD_NS / 1e6:.1f} ms away" in fault.detail


@pytest.mark.parametrize("delay_us", [0, 500, 10_000, 15_000])
def test_a_trigger_delay_is_no_lateness(delay_us: int) -> None:
    """The rig file allows up to 15 ms: most of a blank, all of it wanted."""
    later = tuple(replace(p, board_time_us=p.board_time_us - DELAY_US + delay_us) for p in clean().pulses)
    assert audit(replace(clean(), delay_us=delay_us, pulses=later)) is None
    if delay_us >= 10_000:
        fault = audit(replace(clean(), delay_us=delay_us))
        assert fault is not None, "the pulses came at once, although they should have waited"
        assert fault.code is FaultCode.PROJECTOR_TIMING


def exposed_later(ledger: Ledger, side: str, k: int, later_us: float) -> Ledger:
    frames = list(ledger.frames[side])
    frames[k] = replace(frames[k], camera_time_ns=(frames[k].camera_time_ns or 0) + round(later_us * 1000))
    return with_frames(ledger, side, frames)


@pytest.mark.parametrize("k", [1, 11, N - 1])
def test_left_and_right_off_their_pulses_in_opposite_ways(k: int) -> None:
    """Each by less than it may, together by more."""
    one = exposed_later(clean(), "left", k, 150.0)
    assert audit(one) is None
    fault = audit(exposed_later(one, "right", k, -150.0))
    assert fault is not None
    assert (fault.code, fault.numbers["frame"]) == (FaultCode.SYNC_LOST, k)
    assert fault.numbers["skew_ms"] == pytest.approx(0.3, abs=0.04)
    assert audit(exposed_later(one, "right", k, 150.0)) is None, "both with the object, not against each other"


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("without", [range(N), [N - 1], [0]], ids=["all", "last", "first"])
def test_frames_without_a_block_id_prove_nothing(side: str, without: Sequence[int]) -> None:
    """A camera that does not number its blocks may have lost one and sent another twice."""
    frames = [replace(f, block_id=None) if k in without else f for k, f in enumerate(clean().frames[side])]
    fault = audit(with_frames(clean(), side, frames))
    assert fault is not None
    assert (fault.code, fault.device) == (FaultCode.FRAME_MISSING, f"camera.{side}")
