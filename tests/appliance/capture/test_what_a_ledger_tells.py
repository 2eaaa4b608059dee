"""Which frame a fault names, what its text counts, how far clocks may wander in a long sequence, and what is written down."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from appliance.capture.ledger import Ledger, audit, frame_fault
from appliance.scan.fault import FaultCode
from drivers.api import Flip, Frame, FrameStatus, Pulse
from tests.appliance.capture.test_ledger import BOARD_START_US, PERIOD_NS, N, clean, with_frames


@pytest.mark.parametrize("k", [1, 2, N // 2, N - 1])
def test_the_frame_that_came_again_is_named(k: int) -> None:
    frames = list(clean().frames["left"])
    frames[k] = replace(frames[k], block_id=frames[0].block_id)
    fault = audit(with_frames(clean(), "left", frames))
    assert fault is not None
    assert (fault.code, fault.device, dict(fault.numbers)) == (FaultCode.FRAME_REPEATED, "camera.left", {"frame": k})
    assert fault.detail == f"camera.left: block 5 arrived again as frame {k}"


@pytest.mark.parametrize("k", [0, 1, N - 2])
def test_the_frame_that_came_too_late_is_named(k: int) -> None:
    frames = list(clean().frames["right"])
    frames[k], frames[k + 1] = frames[k + 1], frames[k]
    fault = audit(with_frames(clean(), "right", frames))
    assert fault is not None
    assert (fault.device, dict(fault.numbers)) == ("camera.right", {"frame": k + 1})
    assert fault.detail == f"camera.right: block {5 + k} arrived after block {6 + k}"


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("k", [0, 1, 2, N // 2, N - 1])
def test_the_first_frame_that_is_missing_is_named(side: str, k: int) -> None:
    frames = [f for n, f in enumerate(clean().frames[side]) if n not in (k, k + 2)]
    fault = audit(with_frames(clean(), side, frames))
    assert fault is not None
    assert (fault.code, fault.device) == (FaultCode.FRAME_MISSING, f"camera.{side}")
    assert dict(fault.numbers) == {"frame": k, "received": len(frames), "expected": N}
    assert fault.detail == f"camera.{side}: {len(frames)} of {N} frames arrived; the first gap is at frame {k}"


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("k", [0, 1, 9, N - 2, N - 1])
def test_a_pulse_that_one_camera_did_not_see_is_named_although_its_numbers_have_no_gap(side: str, k: int) -> None:
    """A camera that was not triggered uses no block id up; its clock says when it was not."""
    frames = [replace(f, block_id=5 + n) for n, f in enumerate(g for m, g in enumerate(clean().frames[side]) if m != k)]
    fault = audit(with_frames(clean(), side, frames))
    assert fault is not None
    assert (fault.code, fault.device, fault.numbers["frame"]) == (FaultCode.FRAME_MISSING, f"camera.{side}", k)


@pytest.mark.parametrize("k", [0, 1, 9, N - 1])
def test_the_first_frame_that_is_missing_is_named_by_its_number_where_cameras_have_no_clock(k: int) -> None:
    bare = replace(
        clean(),
        clocks={},
        frames={
            side: tuple(replace(f, camera_time_ns=None) for f in frames) for side, frames in clean().frames.items()
        },
    )
    fault = audit(with_frames(bare, "left", [f for n, f in enumerate(bare.frames["left"]) if n != k]))
    assert fault is not None
    assert (fault.code, fault.device, fault.numbers["frame"]) == (FaultCode.FRAME_MISSING, "camera.left", k)


def test_cameras_that_count_from_different_numbers_lack_no_frame_for_that() -> None:
    """Their clocks say that they began together."""
    counted = [replace(f, block_id=(f.block_id or 0) + 1) for f in clean().frames["right"]]
    assert audit(with_frames(clean(), "right", counted)) is None
    fault = audit(with_frames(clean(), "right", [f for n, f in enumerate(counted) if n != 9]))
    assert fault is not None
    assert fault.numbers["frame"] == 9


def test_a_camera_that_took_nothing_of_all_pulses_was_not_triggered() -> None:
    fault = audit(with_frames(clean(), "right", []))
    assert fault is not None
    assert (fault.code, fault.device, fault.numbers["received"]) == (FaultCode.CAMERA_SILENT, "camera.right", 0)
    assert fault.detail.startswith(f"camera.right: 0 of {N} frames arrived of as many pulses; check the trigger cable")


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("every", [2, 3, 8])
def test_a_camera_that_takes_each_nth_pulse_alone_is_too_slow(every: int, first: int) -> None:
    """It uses no block id up for a pulse that finds it busy; its clock tells which it took."""
    frames = [replace(f, block_id=5 + n) for n, f in enumerate(clean().frames["right"][first::every])]
    fault = audit(with_frames(clean(), "right", frames))
    assert fault is not None
    assert (fault.code, fault.device, fault.numbers["every"]) == (FaultCode.CAMERA_TOO_SLOW, "camera.right", every)
    assert f"one for every {every} pulses" in fault.detail
    assert fault.numbers["frame"] == (0 if first else 1)


@pytest.mark.parametrize(
    "taken", [[0, 2, 4], [0, 2, 4, 6, 8, 11], [0, 23], list(range(23)), [*range(0, 11, 2), *range(13, 24, 2)]]
)
def test_frames_that_lie_otherwise_are_missing_and_no_word_is_said_of_the_camera(taken: list[int]) -> None:
    frames = [replace(clean().frames["right"][k], block_id=5 + n) for n, k in enumerate(taken)]
    fault = audit(with_frames(clean(), "right", frames))
    assert fault is not None
    assert fault.code is FaultCode.FRAME_MISSING


def test_a_camera_that_sent_nothing_of_a_sequence_that_ended_early_is_not_called_silent() -> None:
    ledger = with_frames(clean(), "right", [])
    fault = frame_fault(replace(ledger, pulses=ledger.pulses[:5]), "right")
    assert fault is not None
    assert fault.code is FaultCode.FRAME_MISSING


def test_without_the_cameras_clock_nothing_is_said_of_its_pace() -> None:
    frames = [replace(f, block_id=5 + n, camera_time_ns=None) for n, f in enumerate(clean().frames["right"][::2])]
    fault = audit(replace(with_frames(clean(), "right", frames), clocks={}))
    assert fault is not None
    assert fault.code is FaultCode.FRAME_MISSING


def test_a_frame_too_many_is_not_told_as_all_of_them() -> None:
    """A headline of FRAMES 24/24 would be no reason."""
    last = clean().frames["left"][-1]
    more = [*clean().frames["left"], replace(last, block_id=(last.block_id or 0) + 1)]
    fault = audit(with_frames(clean(), "left", more))
    assert fault is not None
    assert (fault.code, fault.numbers["received"], fault.numbers["expected"]) == (FaultCode.FRAME_MISSING, N - 1, N)


def test_a_damaged_frame_says_how_many_came_before_it() -> None:
    frames = [*clean().frames["right"][:9], Frame(FrameStatus.TRUNCATED, 14, None, 0, "cut")]
    fault = audit(with_frames(clean(), "right", frames))
    assert fault is not None
    assert dict(fault.numbers) == {"frame": 9, "received": 9, "expected": N}
    assert (fault.device, fault.detail) == ("camera.right", "camera.right: frame 9 arrived truncated (cut)")


@pytest.mark.parametrize(
    ("missing", "said"),
    [((9,), "0-8, 10-23"), ((0,), "1-23"), ((1,), "0, 2-23"), ((2, 3, 23), "0-1, 4-22"), (tuple(range(N)), "none")],
)
def test_the_pulses_that_came_are_told_as_ranges(missing: tuple[int, ...], said: str) -> None:
    fault = audit(replace(clean(), pulses=tuple(p for p in clean().pulses if p.index not in missing)))
    assert fault is not None
    assert (fault.code, fault.device) == (FaultCode.PULSE_MISSING, "board")
    assert dict(fault.numbers) == {"received": N - len(missing), "expected": N}
    assert fault.detail == f"the board reported pulses {said} of {N}"


@pytest.mark.parametrize("blanks", [1, 2, 5])
@pytest.mark.parametrize("counted", [True, False])
def test_how_many_blanks_a_flip_was_late_is_told(blanks: int, counted: bool) -> None:
    flips = tuple(
        replace(
            f,
            sequence=(f.sequence or 0) + (blanks if f.index >= 7 else 0) if counted else None,
            time_ns=f.time_ns + (round(blanks * PERIOD_NS) if f.index >= 7 else 0),
        )
        for f in clean().flips
    )
    fault = audit(replace(clean(), flips=flips))
    assert fault is not None
    assert dict(fault.numbers) == {"frame": 7, "late_blanks": blanks}
    assert fault.detail == f"pattern 7 reached the screen {blanks} vertical blanks late"
    assert fault.device == "projector"


@pytest.mark.parametrize("periods", [-2, -1, 1, 2])
def test_by_how_many_patterns_the_projector_is_off_is_told(periods: int) -> None:
    later_us = round(periods * PERIOD_NS / 1000)
    pulses = tuple(replace(p, board_time_us=p.board_time_us + later_us) for p in clean().pulses)
    fault = audit(replace(clean(), pulses=pulses))
    assert fault is not None
    assert (fault.code, fault.device) == (FaultCode.PROJECTOR_TIMING, "projector")
    assert dict(fault.numbers) == {"frame": 0, "shift_frames": periods}


def test_a_board_that_was_never_matched_to_the_projector() -> None:
    fault = audit(replace(clean(), sync=None))
    assert fault is not None
    assert (fault.code, fault.device) == (FaultCode.SYNC_LOST, "board")


def slow(refresh_hz: float, left_ppm: float, right_ppm: float) -> Ledger:
    """A clean sequence at a slow rate, whose cameras' clocks are off by so much against the board's."""
    period_ns = 1e9 / refresh_hz
    before = clean()

    def frames(ppm: float) -> tuple[Frame, ...]:
        return tuple(
            Frame(FrameStatus.COMPLETE, k, 1000 + int(k * period_ns * (1 + ppm * 1e-6)), int(k * period_ns))
            for k in range(N)
        )

    return replace(
        before,
        period_ns=period_ns,
        flips=tuple(Flip(k, 1000 + k, int(7e9 + k * period_ns)) for k in range(N)),
        pulses=tuple(Pulse(k, 200 + k, int(BOARD_START_US + 500 + k * period_ns / 1000)) for k in range(N)),
        frames={"left": frames(left_ppm), "right": frames(right_ppm)},
        clocks={},
    )


@pytest.mark.parametrize(("ppm", "passes"), [(90.0, True), (-90.0, True), (190.0, True), (220.0, False)])
def test_clocks_may_wander_by_their_rate_in_a_long_sequence(ppm: float, passes: bool) -> None:
    """23 s at one picture a second: 200 ppm are 4.6 ms."""
    fault = audit(slow(1.0, ppm, ppm))
    assert (fault is None) == passes
    if fault is not None:
        assert (fault.code, fault.device) == (FaultCode.SYNC_LOST, "camera.left")


def test_two_clocks_that_wander_apart_by_more_than_both_may() -> None:
    assert audit(slow(1.0, 90.0, -90.0)) is None
    fault = audit(slow(1.0, 110.0, -110.0))
    assert fault is not None
    assert (fault.code, fault.numbers["frame"]) == (FaultCode.SYNC_LOST, 1)


def test_a_camera_without_time_stamps_is_judged_by_its_ids_alone() -> None:
    bare = [replace(f, camera_time_ns=None) for f in clean().frames["left"]]
    assert audit(with_frames(clean(), "left", bare)) is None
    late = list(clean().frames["right"])
    late[3] = replace(late[3], camera_time_ns=(late[3].camera_time_ns or 0) + 3_000_000)
    fault = audit(with_frames(with_frames(clean(), "left", bare), "right", late))
    assert fault is not None, "the other one has stamps"
    assert (fault.device, fault.numbers["frame"]) == ("camera.right", 3)


@pytest.mark.parametrize(("apart_us", "passes"), [(600, True), (-600, True), (800, False), (-800, False)])
def test_reading_the_cameras_clocks_leaves_half_of_what_it_took_open(apart_us: int, passes: bool) -> None:
    """0.5 ms, and 0.2 ms more for two answers that took 0.1 and 0.3 ms."""
    clocks = {
        side: replace(c, host_sent_ns=middle - took_ns // 2, host_received_ns=middle + took_ns // 2)
        for (side, c), took_ns in zip(clean().clocks.items(), (100_000, 300_000), strict=True)
        for middle in [(c.host_sent_ns + c.host_received_ns) // 2]
    }
    later = [replace(f, camera_time_ns=(f.camera_time_ns or 0) + apart_us * 1000) for f in clean().frames["right"]]
    fault = audit(with_frames(replace(clean(), clocks=clocks), "right", later))
    assert (fault is None) == passes


def test_the_manifest_gets_every_number_of_the_four_witnesses() -> None:
    ledger = clean()
    said = json.loads(json.dumps(ledger.as_dict()))
    assert (said["expected"], said["start_sequence"], said["start_vsync"], said["trigger_delay_us"]) == (
        *(N, 1000, 200, 500),
    )
    assert said["period_ns"] == PERIOD_NS
    assert said["flips"][3] == {"sequence": 1003, "time_ns": ledger.flips[3].time_ns}
    assert said["pulses"][3] == {"index": 3, "vsync": 203, "board_time_us": ledger.pulses[3].board_time_us}
    frame = ledger.frames["right"][3]
    assert said["frames"]["right"][3] == {
        "status": "complete",
        "block_id": 8,
        "camera_time_ns": frame.camera_time_ns,
        "received_ns": frame.received_ns,
    }
    clock = ledger.clocks["left"]
    assert said["clocks"]["left"] == {
        "camera_time_ns": clock.camera_time_ns,
        "host_sent_ns": clock.host_sent_ns,
        "host_received_ns": clock.host_received_ns,
    }
    assert [len(said["frames"][side]) for side in ("left", "right")] == [N, N]
