"""The whole board on an emulated RP2040: the core, ``chip.py`` and the PIO together, from a command to the trigger line."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.board.firmware import instrument, pins
from drivers.board.firmware.core import BoardCore
from tests.drivers.board.firmware.emulated import PERIOD_US, SYNC_WIDTH_US, WATCHDOG, Emulated, install
from tests.drivers.board.firmware.test_conformance import Host, framed
from tests.drivers.board.firmware.test_pio import US

pytestmark = pytest.mark.devices


class Board:
    """The board as a host has it."""

    def __init__(self, emulated: Emulated, module: Any) -> None:
        self.emulated, self.module = emulated, module
        self.hardware = module.ChipHardware("RP2040", "KF-BRD-EMU")
        self.core = BoardCore(self.hardware, "KF-BRD-EMU", module.reset_cause("RP2040"))

    def exchange(self, data: bytes, time_us: int) -> bytes:
        self.emulated.heard += data
        end = self.emulated.chip.now + time_us * US
        while self.emulated.chip.now < end:
            self.core.step()
            self.hardware.pump()
            # A turn of the loop takes about a millisecond.
            self.emulated.pass_cycles(800 * US)
        said, self.emulated.said = self.emulated.said, b""
        return said

    def sync(self, there: bool) -> None:
        self.emulated.synced = there


@pytest.fixture
def board(monkeypatch: pytest.MonkeyPatch) -> Board:
    emulated = Emulated()
    emulated.sync_rises = instrument.SYNC_RISES
    return Board(emulated, install(emulated, monkeypatch))


@pytest.fixture
def host(board: Board) -> Host:
    made = Host(board, wired=False)
    made.listen(60_000)
    return made


def test_an_armed_series_leaves_the_pins_as_it_was_ordered_and_is_told_as_it_was(board: Board, host: Host) -> None:
    _, _, count, sync_us, _ = host.ask("VSYNC")
    start = int(count) + 5
    assert host.ask("ARM", 3, start, 700, 2000)[0] == "A"
    said = host.listen(140_000)
    rises = board.emulated.chip.rises()
    assert len(rises) == 3
    # Syncs come at multiples of the period; the first counted one is the first after the firmware began.
    edges_us = [rise / US - 700 for rise in rises]
    assert all(abs(edge_us % PERIOD_US) < 0.1 or abs(edge_us % PERIOD_US - PERIOD_US) < 0.1 for edge_us in edges_us)
    assert board.emulated.chip.widths() == [2000 * US] * 3
    told = [(int(w[0]), int(w[1]), int(w[2])) for _, _, verb, *w in said if verb == "PULSE"]
    assert [(k, vsync) for k, vsync, _ in told] == [(k, start + k) for k in range(3)]
    # The board's clock begins with the firmware, the emulator's before.
    began_us = board.hardware._began_us
    assert all(abs(rise / US - began_us - time_us) < 12 for rise, (_, _, time_us) in zip(rises, told, strict=True))
    sync_of_first_us = int(sync_us) + 5 * PERIOD_US
    assert abs(told[0][2] - sync_of_first_us - 700) <= 1, "sync and pulse are stamped by one clock"
    assert [w for _, _, verb, *w in said if verb == "DONE"] == [["3"]]


@pytest.mark.parametrize(
    ("rises", "told", "late_us"),
    [(True, True, 0), (False, False, 0), (False, True, SYNC_WIDTH_US)],
    ids=["positive", "negative", "negative, told the other"],
)
def test_pulses_follow_the_edge_that_begins_the_sync_where_the_firmware_is_told_its_sign(
    monkeypatch: pytest.MonkeyPatch, rises: bool, told: bool, late_us: int
) -> None:
    emulated = Emulated()
    emulated.sync_rises = rises
    monkeypatch.setattr(instrument, "SYNC_RISES", told)
    host = Host(Board(emulated, install(emulated, monkeypatch)), wired=False)
    host.listen(60_000)
    host.ask("ARM", 2, host.count() + 4, 700, 2000)
    host.listen(140_000)
    rises_us = [rise / US for rise in emulated.chip.rises()]
    assert len(rises_us) == 2
    # The wrong edge is the sync's end: everything comes late by its width, and nothing else tells.
    assert all(abs((at_us - 700 - late_us + 1) % PERIOD_US - 1) < 0.1 for at_us in rises_us), rises_us


def test_a_second_series_knows_nothing_of_the_syncs_after_the_first(board: Board, host: Host) -> None:
    assert host.ask("ARM", 1, host.count() + 3, 300, 1000)[0] == "A"
    host.listen(80_000)
    scope = board.emulated.chip.scope
    assert len(scope) == 2
    start = host.count() + 3
    assert host.ask("ARM", 1, start, 300, 1000)[0] == "A"
    assert [int(words[1]) for words in host.reports(60_000, "PULSE")] == [start]
    assert len(scope) == 4
    assert abs((scope[2][0] // US - 300 + 1) % PERIOD_US) <= 1


def test_a_series_armed_within_a_live_pulse_lets_it_end(board: Board, host: Host) -> None:
    host.ask("LIVE", 1, 0, 12_000)
    host.listen(40_000)
    scope = board.emulated.chip.scope
    while not scope[-1][1]:
        host.listen(1000)
    start = board.core._count + 4
    assert host.ask("ARM", 2, start, 500, 3000)[0] == "A"
    host.listen(120_000)
    widths = board.emulated.chip.widths()
    assert widths[-2:] == [3000 * US] * 2
    assert set(widths[:-2]) == {12_000 * US}, "no pulse was cut"


def test_stop_and_a_lost_signal_end_the_pulses(board: Board, host: Host) -> None:
    host.ask("LIVE", 1, 300, 1000)
    host.listen(40_000)
    host.ask("STOP")
    fired = len(board.emulated.chip.scope)
    assert fired
    host.listen(50_000)
    assert len(board.emulated.chip.scope) == fired
    host.ask("LIVE", 1, 300, 1000)
    board.sync(False)
    assert "NOSYNC" in [line[2] for line in host.listen(90_000)]


def test_lasers_are_read_back_and_their_gate_gets_edges(board: Board, host: Host) -> None:
    assert host.ask("LASER", 1, 0) == ["A", "LASER", "1", "0"]
    assert board.emulated.levels[pins.gpio("LASER_LEFT")] == 1
    assert host.ask("LASER", 0, 0) == ["A", "LASER", "0", "0"]
    seen = []
    for _ in range(4):
        board.core.step()
        seen.append(board.emulated.levels[pins.gpio("LASER_BEAT")])
    assert seen in ([0, 1, 0, 1], [1, 0, 1, 0])
    assert board.emulated.fed > 8


def test_the_sensors_are_those_that_answer(board: Board, host: Host) -> None:
    assert host.ask("INFO")[4] == "TPROJ+TCASE+TBOARD+LEAK+HUM+SUPPLY"
    values = dict(field.split("=") for field in host.ask("SENSE")[2:])
    assert ",".join(f"{name}={value}" for name, value in values.items()) == (
        "TPROJ=31.25,TCASE=25.00,TBOARD=25.00,LEAK=0,HUM=50.3,SUPPLY=24.09"
    )
    del board.emulated.sensors[0x44]
    board.emulated.levels[pins.gpio("LEAK_REAR")] = 1
    host.listen(300_000)
    values = dict(field.split("=") for field in host.ask("SENSE")[2:])
    assert (values["TBOARD"], values["HUM"], values["LEAK"]) == ("-", "-", "1")


def test_a_chip_that_is_not_there_at_the_start_is_not_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    emulated = Emulated()
    emulated.sync_rises = instrument.SYNC_RISES
    del emulated.sensors[0x48]
    board = Board(emulated, install(emulated, monkeypatch))
    assert Host(board, wired=False).ask("INFO")[4] == "TCASE+TBOARD+LEAK+HUM+SUPPLY"


@pytest.mark.parametrize(
    ("cause", "asked", "told"), [(1, False, "POWER"), (WATCHDOG, False, "WATCHDOG"), (WATCHDOG, True, "HOST")]
)
def test_the_cause_of_a_reset_is_told_once(monkeypatch: pytest.MonkeyPatch, cause: int, asked: bool, told: str) -> None:
    emulated = Emulated()
    module = install(emulated, monkeypatch)
    emulated.reset_cause = cause
    emulated.scratch = module.HOST_MARK if asked else 0
    assert module.reset_cause("RP2040") == told
    assert emulated.scratch == 0


def test_it_appears_as_what_the_protocol_says(board: Board) -> None:
    import usb

    identity = usb.device.identity
    assert (identity["id_vendor"], identity["id_product"]) == (0x1209, 0x4B42)
    assert identity["serial_str"] == "KF-BRD-EMU"
    assert not identity["builtin_driver"]


def test_what_is_said_while_nobody_listens_is_lost_and_the_next_line_is_whole(board: Board, host: Host) -> None:
    board.emulated.listening = False
    assert host.listen(20_000, framed("C,77,SENSE")) == []
    board.emulated.listening = True
    assert host.ask("PING")[:2] == ["A", "PING"]
