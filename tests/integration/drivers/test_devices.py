"""Drivers of board, key pad and camera against their simulated counterparts; the scenarios have what becomes of their faults."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.api import (
    DeviceGone,
    DeviceRefused,
    Frame,
    FrameStatus,
    Key,
    KeyEvent,
    KeyLongPress,
    KeyPress,
    KeyRelease,
    LaserState,
    Telemetry,
)
from drivers.board import TriggerBoard
from drivers.board.board import BoardRefused
from drivers.board.reports import Refusal
from tests.integration.drivers.conftest import HEIGHT, WIDTH, Rig

LIVE_US = (500, 8000)


def heartbeat(board: TriggerBoard) -> Telemetry:
    for _ in range(15):
        event = board.next_event(0.1)
        if isinstance(event, Telemetry):
            return event
    raise AssertionError("no heartbeat within 1.5 s")


def refusal(board: TriggerBoard, *arguments: int) -> int:
    with pytest.raises(BoardRefused) as refused:
        board.arm(*arguments)
    return refused.value.code


def test_the_board_says_who_it_is_counts_lights_and_refuses(rig: Rig) -> None:
    board = rig.board()
    assert board.info.serial
    assert board.health().ok, board.health()
    first = board.vsync()
    rig.wires.clock.sleep_s(0.5)
    second = board.vsync()
    host_us = (second.host_received_ns - first.host_received_ns) * 1e-3
    assert second.board_now_us - first.board_now_us == pytest.approx(host_us, abs=60_000)
    board_us = second.board_time_us - first.board_time_us
    assert second.count - first.count == pytest.approx(board_us * 60e-6, abs=0.1)
    beats = [heartbeat(board) for _ in range(2)]
    assert beats[1].board_time_us - beats[0].board_time_us == pytest.approx(500_000, abs=1000)
    assert 0.0 < (beats[1].temperature_projector_c or 0.0) < 90.0
    for wanted in ((True, False), (False, True), (False, False)):
        assert board.set_lasers(*wanted) == LaserState(*wanted)
    far = second.count + 10_000
    assert refusal(board, 65, far, 500, 12_000) == Refusal.OUT_OF_RANGE
    assert refusal(board, 24, 1, 500, 12_000) == Refusal.PAST
    board.arm(2, far, 500, 8000)
    assert refusal(board, 2, far, 500, 8000) == Refusal.BUSY
    board.stop()
    board.arm(2, far, 500, 8000)
    board.stop()
    assert (board.counters.damaged_lines, board.counters.lost_reports) == (0, 0)


def test_noise_on_the_line_costs_no_command_and_an_answer_that_is_too_late_breaks_the_contract(rig: Rig) -> None:
    board = rig.board()
    rig.world.fault("board garbage")
    for _ in range(5):
        board.vsync()
        rig.wires.clock.sleep_s(0.05)
    heartbeat(board)
    assert board.counters.garbage_bytes + board.counters.damaged_lines > 0
    rig.world.clear_faults()
    rig.world.fault("board slow")
    with pytest.raises(DeviceGone, match="VSYNC"):
        board.vsync()
    rig.world.clear_faults()
    rig.wires.clock.sleep_s(0.6)
    assert board.vsync().count > 0
    assert board.counters.late_answers >= 1


def test_one_press_is_one_press_of_that_key_and_a_long_one_is_press_long_release(rig: Rig) -> None:
    keys = rig.keys()

    def said(key: str, hold_s: float) -> list[KeyEvent]:
        rig.world.press(key, hold_s=hold_s)
        end_ns = rig.wires.clock.now_ns() + round((hold_s + 0.45) * 1e9)
        heard: list[KeyEvent | None] = []
        while rig.wires.clock.now_ns() < end_ns:
            heard.append(keys.next_event(0.05))
        return [event for event in heard if event is not None]

    for key in Key:
        press, release = said(key.value, 0.15)
        assert isinstance(press, KeyPress)
        assert isinstance(release, KeyRelease)
        assert (press.key, release.key) == (key, key)
        assert release.held_s == pytest.approx(0.15, abs=0.1)
    assert [type(event) for event in said("back", 1.1)] == [KeyPress, KeyLongPress, KeyRelease]


def test_frames_come_with_triggers_alone_and_a_second_start_throws_away_what_is_queued(rig: Rig) -> None:
    camera, board = rig.camera(), rig.board()

    def grab() -> Frame:
        return camera.next_frame(np.zeros((HEIGHT, WIDTH), np.uint8), 1.0)

    camera.start()
    assert camera.next_frame(np.zeros((HEIGHT, WIDTH), np.uint8), 0.2).status is FrameStatus.TIMEOUT
    board.live(2, *LIVE_US)
    frames = [grab() for _ in range(6)]
    assert [frame.status for frame in frames] == [FrameStatus.COMPLETE] * 6, frames
    assert np.diff([frame.block_id or 0 for frame in frames]).tolist() == [1] * 5
    times_ns = [frame.camera_time_ns or 0 for frame in frames]
    np.testing.assert_allclose(np.diff(times_ns), 2e9 / 60, rtol=1e-3)
    rig.wires.clock.sleep_s(0.3)
    board.stop()
    rig.wires.clock.sleep_s(0.1)  # an exposure that had begun ends, and its frame arrives
    camera.start()
    assert camera.next_frame(np.zeros((HEIGHT, WIDTH), np.uint8), 0.2).status is FrameStatus.TIMEOUT
    board.live(2, *LIVE_US)
    again = grab()
    assert (again.status, again.block_id) == (FrameStatus.COMPLETE, frames[0].block_id)
    camera.stop()
    camera.stop()
    with pytest.raises(DeviceRefused, match="stopped"):
        grab()
