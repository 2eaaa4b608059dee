"""The whole board on an emulated RP2040: the core, ``chip.py`` and the PIO together, from a command to the trigger line."""

from __future__ import annotations

import re
from typing import Any

import pytest

from drivers.board.firmware import instrument, pins, pio
from drivers.board.firmware.core import BoardCore
from tests.drivers.board.firmware.emulated import CLOCK_HZ, PERIOD_US, US, WATCHDOG, Emulated, install
from tests.drivers.board.firmware.test_conformance import Host
from tests.hw_sim.devices.host import framed

pytestmark = pytest.mark.devices


class Board:
    """The board as a host has it."""

    def __init__(self, emulated: Emulated, module: Any) -> None:
        self.emulated, self.module = emulated, module
        self.hardware = module.ChipHardware("RP2040", "KF-BRD-EMU")
        self.core = BoardCore(self.hardware, "KF-BRD-EMU", module.reset_cause("RP2040"))

    def exchange(self, data: bytes, time_us: int) -> bytes:
        """Whoever asked goes on as soon as there is an answer."""
        self.emulated.heard += data
        end = self.emulated.chip.now + time_us * US
        while self.emulated.chip.now < end and not (data and re.search(rb"\$[AN].*\n", self.emulated.said)):
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
    listening = Host(board)
    listening.listen(15_000)
    return listening


def test_armed_series_leave_the_pins_as_they_were_ordered_and_are_told_as_they_were(board: Board, host: Host) -> None:
    chip = board.emulated.chip
    _, _, count, sync_us, _ = host.ask("VSYNC")
    start = int(count) + 2
    assert host.ask("ARM", 3, start, 700, 2000)[0] == "A"
    said = host.listen(35_000)
    rises = chip.rises()
    assert len(rises) == 3
    # Syncs come at multiples of the period; the first counted one is the first after the firmware began.
    assert all(abs((rise / US - 700 + 1) % PERIOD_US - 1) < 0.1 for rise in rises)
    assert chip.widths() == [2000 * US] * 3
    told = [(int(w[0]), int(w[1]), int(w[2])) for _, _, verb, *w in said if verb == "PULSE"]
    assert [(k, vsync) for k, vsync, _ in told] == [(k, start + k) for k in range(3)]
    # The board's clock begins with the firmware, the emulator's before.
    began_us = board.hardware._began_us
    assert all(abs(rise / US - began_us - time_us) < 12 for rise, (_, _, time_us) in zip(rises, told, strict=True))
    assert abs(told[0][2] - int(sync_us) - 2 * PERIOD_US - 700) <= 1, "sync and pulse are stamped by one clock"
    assert [w for _, _, verb, *w in said if verb == "DONE"] == [["3"]]
    # A second series knows nothing of the syncs after the first.
    chip.scope.clear()
    start = host.count() + 2
    assert host.ask("ARM", 1, start, 300, 1000)[0] == "A"
    assert [int(words[1]) for words in host.reports(18_000, "PULSE")] == [start]
    assert len(chip.scope) == 2
    assert abs((chip.scope[0][0] / US - 300 + 1) % PERIOD_US - 1) < 0.1


def test_pulses_follow_the_edge_that_begins_the_sync_where_the_firmware_is_told_its_sign(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The wrong edge is the sync's end: everything would come late by its width, and nothing else would tell."""
    emulated = Emulated()
    emulated.sync_rises = not instrument.SYNC_RISES
    monkeypatch.setattr(instrument, "SYNC_RISES", emulated.sync_rises)
    host = Host(Board(emulated, install(emulated, monkeypatch)))
    host.listen(15_000)
    host.ask("ARM", 1, host.count() + 2, 700, 2000)
    host.listen(15_000)
    (rise,) = emulated.chip.rises()
    assert abs((rise / US - 700 + 1) % PERIOD_US - 1) < 0.1


def test_neither_a_series_nor_a_stop_within_a_live_pulse_cuts_it_and_a_lost_signal_ends_them(
    board: Board, host: Host
) -> None:
    scope = board.emulated.chip.scope

    def live_until_within_a_pulse() -> None:
        host.ask("LIVE", 1, 0, 3600)
        host.listen(5000)
        while not (scope and scope[-1][1]):
            host.listen(1000)

    live_until_within_a_pulse()
    start = board.core._count + 2
    assert host.ask("ARM", 2, start, 500, 1000)[0] == "A"
    host.listen(20_000)
    assert board.emulated.chip.widths()[-2:] == [1000 * US] * 2
    assert set(board.emulated.chip.widths()[:-2]) == {3600 * US}
    scope.clear()
    live_until_within_a_pulse()
    host.ask("STOP")
    host.listen(5000)
    assert set(board.emulated.chip.widths()) == {3600 * US}
    fired = len(scope)
    host.listen(6000)
    assert len(scope) == fired
    host.ask("LIVE", 1, 300, 1000)
    board.sync(False)
    assert "NOSYNC" in [line[2] for line in host.listen(70_000)]


def test_lasers_are_read_back_and_the_sensors_are_those_that_answer(board: Board, host: Host) -> None:
    emulated = board.emulated
    assert host.ask("LASER", 1, 0) == ["A", "LASER", "1", "0"]
    assert emulated.levels[pins.gpio("LASER_LEFT")] == 1
    assert host.ask("LASER", 0, 0) == ["A", "LASER", "0", "0"]
    seen = []
    for _ in range(4):
        board.core.step()
        seen.append(emulated.levels[pins.gpio("LASER_BEAT")])
    assert seen in ([0, 1, 0, 1], [1, 0, 1, 0]), "the gate gets edges"
    assert emulated.fed > 8
    assert host.ask("INFO")[4] == "TPROJ+TCASE+TBOARD+LEAK+HUM+SUPPLY"
    values = "TPROJ=31.25 TCASE=25.00 TBOARD=25.00 LEAK=0 HUM=50.3 SUPPLY=24.09"
    assert host.ask("SENSE")[2:] == values.split()
    del emulated.sensors[0x44]
    emulated.levels[pins.gpio("LEAK_REAR")] = 1
    for _ in 2 * values.split():
        board.core._measure_one()  # one each 40 ms
    later = dict(field.split("=") for field in host.ask("SENSE")[2:])
    assert (later["TBOARD"], later["HUM"], later["LEAK"]) == ("-", "-", "1")
    emulated.listening = False
    assert host.listen(10_000, framed("C,77,SENSE")) == [], "lost while nobody listens"
    emulated.listening = True
    assert host.ask("PING")[:2] == ["A", "PING"]


def test_a_chip_that_is_not_there_at_the_start_is_not_fitted_and_the_board_appears_as_the_protocol_says(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import usb

    emulated = Emulated()
    del emulated.sensors[0x48]
    host = Host(Board(emulated, install(emulated, monkeypatch)))
    assert host.ask("INFO")[4] == "TCASE+TBOARD+LEAK+HUM+SUPPLY"
    identity = usb.device.identity
    assert (identity["id_vendor"], identity["id_product"]) == (0x1209, 0x4B42)
    assert identity["serial_str"] == "KF-BRD-EMU"
    assert not identity["builtin_driver"]


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


# ---- the PIO programs, clock by clock, with syncs far faster than a projector's


WAITS = 2
"""Clocks that the emulator does not spend and the chip does: one for each WAIT that ends at once, for the pin and for the flag."""


def hardware_on(emulated: Emulated, monkeypatch: pytest.MonkeyPatch) -> Any:
    emulated.sync_rises = instrument.SYNC_RISES
    return install(emulated, monkeypatch).ChipHardware("RP2040", "KF-BRD-EMU")


@pytest.mark.parametrize(
    ("skip", "every", "pulses", "delay_us", "width_us", "period_us"),
    [
        (0, 1, 1, 1, 50, 200), (1, 1, 4, 100, 60, 200), (5, 1, 7, 13, 150, 200), (0, 1, 3, 0, 50, 200),
        (0, 1, 1, 15_000, 16_000, 16_667), (0, 1, 40, 5, 50, 100), (0, 60, 3, 5, 50, 100),
    ],
)  # fmt: skip
def test_pulses_are_as_ordered_to_the_clock(
    skip: int, every: int, pulses: int, delay_us: int, width_us: int, period_us: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    emulated = Emulated(period_us, 3 * period_us // 4)
    hardware, chip = hardware_on(emulated, monkeypatch), emulated.chip
    while not emulated.edges:
        emulated.pass_cycles(US)
    hardware.start(skip, every, None if every > 1 else pulses, delay_us, width_us)
    begun = chip.now  # within a sync, which is not counted
    end = begun + ((skip + every * pulses + 2) * period_us + delay_us + width_us) * US
    while len(chip.scope) < 2 * pulses and chip.now < end:
        emulated.pass_cycles(10 * US)
    if every == 1 and period_us < 1000:  # and no more
        emulated.pass_cycles(2 * period_us * US)
    edges = [edge for edge in emulated.edges if edge >= begun][skip::every][:pulses]
    late = [
        rise + WAITS + pio.SYNCHRONISER_CYCLES - edge - delay_us * US
        for rise, edge in zip(chip.rises(), edges, strict=True)
    ]
    assert late == [0 if delay_us else pio.GATE_CYCLES + pio.SYNCHRONISER_CYCLES] * pulses
    assert (pio.GATE_CYCLES + pio.SYNCHRONISER_CYCLES) / US < 0.1, "no delay is late by less than a tenth of a us"
    assert chip.widths() == [width_us * US] * pulses


def test_stamps_are_right_to_a_microsecond_for_ever_and_those_that_nobody_reads_are_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    emulated = Emulated(97, 31)
    hardware = hardware_on(emulated, monkeypatch)
    while hardware.next_sync() is not None:  # those of before anybody could look
        pass
    hardware.syncs_lost()
    stamps_us: list[int] = []
    while len(stamps_us) < 60:
        emulated.pass_cycles(40 * US)
        stamp_us = hardware.next_sync()
        stamps_us += [] if stamp_us is None else [stamp_us]
    assert all(abs(us - stamps_us[0] - 97 * k) <= 1 for k, us in enumerate(stamps_us))
    assert not hardware.syncs_lost()
    emulated.pass_cycles(12 * 97 * US)
    assert hardware.syncs_lost()
    kept_us = [hardware.next_sync() for _ in range(4)]  # the emulator does not join FIFOs; the chip's has eight
    assert kept_us == [stamps_us[-1] + 97 * k for k in (1, 2, 3, 4)]


def test_the_programs_fit_one_block_and_numbers_that_do_not_are_refused() -> None:
    assert len(pio.GATE.words) + len(pio.PULSE.words) + len(pio.STAMP.words) <= 32
    with pytest.raises(ValueError, match="delay_us=200000, every=1"):
        pio.gate_words(0, 1, 200_000, CLOCK_HZ)
    with pytest.raises(ValueError, match="every=257"):
        pio.gate_words(0, 257, 0, CLOCK_HZ)
    assert pio.gate_words(0, 60, 15_000, 150_000_000)[1] >> 24 == 59, "RP2350 at 150 MHz"


@pytest.mark.parametrize(
    ("stamp", "now_us", "time_us"),
    [
        (11, 1015, 1010),
        (0xFFFF_FFFF, 1000 + (1 << 32), 1000 + (1 << 32) - 2),
        (4, 1000 + (5 << 32) + 40, 1003 + (5 << 32)),
        (0, 1000 + (5 << 32) + 40, 999 + (5 << 32)),
        (13, 1011, 1012),
    ],
    ids=["young", "last before the wrap", "sixth turn", "behind the wrap", "ahead of the clock"],
)
def test_a_stamp_is_extended_to_the_boards_clock(stamp: int, now_us: int, time_us: int) -> None:
    assert pio.stamp_us(stamp, 1000, now_us) == time_us
