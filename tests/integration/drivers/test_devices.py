"""Drivers of board, key pad and camera against their simulated counterparts; the scenarios have what becomes of their faults."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.api import (
    CameraSettings,
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
from drivers.camera import UsbVisionCamera
from tests.integration.drivers.conftest import HEIGHT, SETTINGS, WIDTH, Rig

LIVE_US = (500, 8000)
WHOLE = FrameStatus.COMPLETE


def heartbeat(board: TriggerBoard) -> Telemetry:
    for _ in range(15):
        event = board.next_event(0.1)
        if isinstance(event, Telemetry):
            return event
    raise AssertionError("no heartbeat within 1.5 s")


def test_the_board_says_who_it_is_and_its_clock_count_and_heartbeats_run(rig: Rig) -> None:
    board = rig.board()
    assert board.info.serial
    assert "TPROJ" in board.info.capabilities
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
    assert beats[1].leak is not True
    assert (board.counters.damaged_lines, board.counters.lost_reports) == (0, 0)


def test_lasers_follow_and_a_stuck_and_a_dead_one_show_in_the_read_back(rig: Rig) -> None:
    board = rig.board()
    for wanted in ((True, False), (False, True), (False, False)):
        assert board.set_lasers(*wanted) == LaserState(*wanted)
    rig.world.fault("laser.left stuck")
    rig.world.fault("laser.right off")
    assert board.set_lasers(False, True) == LaserState(True, False)


def test_what_the_board_cannot_do_it_refuses_and_armed_it_is_busy_until_stopped(rig: Rig) -> None:
    board = rig.board()
    rig.wires.clock.sleep_s(0.1)  # so that vertical sync number 1 is past
    far = board.vsync().count + 10_000
    for code, arguments in (
        (Refusal.OUT_OF_RANGE, (0, far, 500, 12_000)),
        (Refusal.OUT_OF_RANGE, (65, far, 500, 12_000)),
        (Refusal.OUT_OF_RANGE, (24, far, 15_001, 12_000)),
        (Refusal.OUT_OF_RANGE, (24, far, 500, 49)),
        (Refusal.PAST, (24, 1, 500, 12_000)),
    ):
        with pytest.raises(BoardRefused) as refused:
            board.arm(*arguments)
        assert refused.value.code == code, arguments
    board.arm(2, far, 500, 8000)
    with pytest.raises(BoardRefused) as refused:
        board.arm(2, far, 500, 8000)
    assert refused.value.code == Refusal.BUSY
    board.stop()
    board.arm(2, far, 500, 8000)
    board.stop()


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


def slot() -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
    return np.zeros((HEIGHT, WIDTH), np.uint8)


def grab(camera: UsbVisionCamera, count: int) -> list[Frame]:
    return [camera.next_frame(slot(), 1.0) for _ in range(count)]


def test_frames_come_with_triggers_alone_and_a_second_start_throws_away_what_is_queued(rig: Rig) -> None:
    camera, board = rig.camera(), rig.board()
    camera.start()
    assert camera.next_frame(slot(), 0.2).status is FrameStatus.TIMEOUT
    board.live(2, *LIVE_US)
    frames = grab(camera, 6)
    assert [frame.status for frame in frames] == [WHOLE] * 6, frames
    assert np.diff([frame.block_id or 0 for frame in frames]).tolist() == [1] * 5
    times_ns = [frame.camera_time_ns or 0 for frame in frames]
    np.testing.assert_allclose(np.diff(times_ns), 2e9 / 60, rtol=1e-3)
    rig.wires.clock.sleep_s(0.3)
    board.stop()
    rig.wires.clock.sleep_s(0.1)  # an exposure that had begun ends, and its frame arrives
    camera.start()
    assert camera.next_frame(slot(), 0.2).status is FrameStatus.TIMEOUT
    board.live(2, *LIVE_US)
    (again,) = grab(camera, 1)
    assert (again.status, again.block_id) == (WHOLE, frames[0].block_id)
    dark, bright = slot(), slot()  # settings change while it streams
    camera.configure(CameraSettings(WIDTH, HEIGHT, SETTINGS.exposure_us / 8, 0.0))
    assert camera.next_frame(dark, 1.0).status is WHOLE
    camera.configure(SETTINGS)
    assert camera.next_frame(bright, 1.0).status is WHOLE
    assert bright.mean() > dark.mean()
    camera.stop()
    camera.stop()
    with pytest.raises(DeviceRefused, match="stopped"):
        camera.next_frame(slot(), 0.1)
