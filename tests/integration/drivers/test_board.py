"""The board driver against the simulated board."""

from __future__ import annotations

from typing import TypeVar

import pytest

from drivers.api import BoardBooted, BoardLost, DeviceGone, LaserState, Pulse, PulsesDone, Telemetry, VsyncLost
from drivers.board import TriggerBoard
from drivers.board.board import BoardRefused
from drivers.board.reports import Refusal
from tests.integration.drivers.conftest import Rig

E = TypeVar("E", Pulse, PulsesDone, VsyncLost, Telemetry, BoardBooted, BoardLost)


def wait_for(rig: Rig, board: TriggerBoard, kind: type[E], timeout_s: float) -> E:
    deadline_ns = rig.wires.clock.now_ns() + round(timeout_s * 1e9)
    while rig.wires.clock.now_ns() < deadline_ns:
        event = board.next_event(0.1)
        if isinstance(event, kind):
            return event
    raise AssertionError(f"no {kind.__name__} within {timeout_s} s")


def test_the_board_says_who_it_is_and_what_is_fitted(rig: Rig) -> None:
    board = rig.board()
    assert board.info.serial
    assert "TPROJ" in board.info.capabilities
    assert board.health().ok, board.health()


def test_the_boards_clock_and_count_run_with_the_host(rig: Rig) -> None:
    board = rig.board()
    first = board.vsync()
    rig.wires.clock.sleep_s(0.5)
    second = board.vsync()
    host_us = (second.host_received_ns - first.host_received_ns) * 1e-3
    assert second.board_now_us - first.board_now_us == pytest.approx(host_us, abs=25_000)
    assert second.count - first.count == pytest.approx(host_us * 60e-6, abs=1.5)
    assert 0 <= second.board_now_us - second.board_time_us < 17_500


def test_heartbeats_come_twice_a_second_with_the_fitted_sensors(rig: Rig) -> None:
    board = rig.board()
    first = wait_for(rig, board, Telemetry, 1.5)
    second = wait_for(rig, board, Telemetry, 1.5)
    assert second.board_time_us - first.board_time_us == pytest.approx(500_000, abs=1000)
    assert second.temperature_projector_c is not None
    assert 0.0 < second.temperature_projector_c < 90.0
    assert second.leak is not True
    assert board.counters.damaged_lines == 0
    assert board.counters.lost_reports == 0


def test_a_sensor_that_does_not_answer_is_unknown(rig: Rig) -> None:
    board = rig.board()
    rig.world.fault("sensor.TPROJ off")
    wait_for(rig, board, Telemetry, 1.5)
    assert wait_for(rig, board, Telemetry, 1.5).temperature_projector_c is None
    rig.world.clear_faults()
    rig.world.fault("leak wrong")
    wait_for(rig, board, Telemetry, 1.5)
    latest = wait_for(rig, board, Telemetry, 1.5)
    assert latest.leak is True
    assert latest.temperature_projector_c is not None


@pytest.mark.parametrize("wanted", [(False, False), (True, False), (False, True), (True, True)])
def test_lasers_follow_and_say_so(rig: Rig, wanted: tuple[bool, bool]) -> None:
    assert rig.board().set_lasers(*wanted) == LaserState(*wanted)


def test_a_stuck_and_a_dead_laser_show_in_the_read_back(rig: Rig) -> None:
    board = rig.board()
    rig.world.fault("laser.left stuck")
    rig.world.fault("laser.right off")
    assert board.set_lasers(False, True) == LaserState(True, False)


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        ((0, 10_000_000, 500, 12_000), Refusal.OUT_OF_RANGE),
        ((65, 10_000_000, 500, 12_000), Refusal.OUT_OF_RANGE),
        ((24, 10_000_000, 15_001, 12_000), Refusal.OUT_OF_RANGE),
        ((24, 10_000_000, 500, 49), Refusal.OUT_OF_RANGE),
        ((24, 1, 500, 12_000), Refusal.PAST),
    ],
)
def test_what_the_board_cannot_do_it_refuses(rig: Rig, arguments: tuple[int, int, int, int], code: Refusal) -> None:
    board = rig.board()
    rig.wires.clock.sleep_s(0.1)  # so that vertical sync number 1 is past
    with pytest.raises(BoardRefused) as caught:
        board.arm(*arguments)
    assert caught.value.code == code


def test_an_armed_board_is_busy_until_stopped(rig: Rig) -> None:
    board = rig.board()
    far = board.vsync().count + 10_000
    board.arm(2, far, 500, 8000)
    with pytest.raises(BoardRefused) as caught:
        board.arm(2, far, 500, 8000)
    assert caught.value.code == Refusal.BUSY
    board.stop()
    board.arm(2, far, 500, 8000)
    board.stop()


def test_a_reset_is_told_and_switches_the_lasers_off(rig: Rig) -> None:
    board = rig.board()
    board.set_lasers(True, True)
    rig.world.fault("board wrong how=reset")
    booted = wait_for(rig, board, BoardBooted, 2.0)
    assert booted.cause in {"POWER", "WATCHDOG", "BROWNOUT", "HOST"}
    assert wait_for(rig, board, Telemetry, 1.5).lasers == LaserState(False, False)
    assert board.counters.lost_reports == 0


def test_a_silent_board_is_lost_within_its_time_and_comes_back(rig: Rig) -> None:
    board = rig.board()
    wait_for(rig, board, Telemetry, 1.5)
    rig.world.fault("board off")
    begin_ns = rig.wires.clock.now_ns()
    lost = wait_for(rig, board, BoardLost, 3.0)
    assert lost.reason
    assert (rig.wires.clock.now_ns() - begin_ns) * 1e-9 < 2.1
    assert board.latest is None
    with pytest.raises(DeviceGone):
        board.stop()
    rig.world.clear_faults()
    assert wait_for(rig, board, Telemetry, 2.0).board_time_us > 0
    board.stop()


def test_noise_on_the_line_is_counted_and_costs_no_command(rig: Rig) -> None:
    board = rig.board()
    rig.world.fault("board garbage")
    for _ in range(10):
        board.vsync()
        rig.wires.clock.sleep_s(0.05)
    wait_for(rig, board, Telemetry, 1.5)
    counters = board.counters
    assert counters.garbage_bytes + counters.damaged_lines > 0


def test_a_board_that_answers_too_late_breaks_its_contract(rig: Rig) -> None:
    board = rig.board()
    rig.world.fault("board slow")
    with pytest.raises(DeviceGone, match="no answer to VSYNC"):
        board.vsync()
    rig.world.clear_faults()
    rig.wires.clock.sleep_s(0.6)
    assert board.vsync().count > 0
    assert board.counters.late_answers >= 1
