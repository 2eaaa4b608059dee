"""The simulated trigger board beyond its protocol (tests/drivers/board/firmware): when it fires, its crystal, its faults."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from hw_sim.clocks import Clocks
from hw_sim.devices.board import Board, Shot
from hw_sim.timing.world_time import BLANK_NS, START_NS
from tests.hw_sim.devices.bench import Bench, bench
from tests.hw_sim.devices.host import framed


class Desk:
    """A board with wires soldered to its trigger lines, and a terminal."""

    def __init__(self, made: Bench, seed: int = 1, clocks: Clocks | None = None) -> None:
        self.bench = made
        self.fired: list[tuple[int, int, Shot]] = []
        """Time and width in ns, and what is known of the pulse."""
        self.vsync_times_ns: list[int] = []
        self.number = 0
        self.board = Board(made.time, made.faults, self._fire, lambda _: "1.0", seed, clocks=clocks)
        self.board.open = True
        made.changed.append(self.board.refresh)
        made.on_blank = self._blank
        made.blanks(3)

    def _fire(self, time_ns: int, width_ns: int, shot: Shot) -> None:
        self.fired.append((time_ns, width_ns, shot))

    def _blank(self, time_ns: int) -> None:
        self.vsync_times_ns.append(time_ns)
        self.board.vsync(time_ns)

    def raw(self) -> bytes:
        return self.board.take(self.board.waiting)

    def lines(self) -> list[list[str]]:
        """All lines since the last call, each checked to the last byte."""
        lines = self.raw().splitlines(keepends=True)
        bodies = [line[1:-7].decode("ascii") for line in lines]
        assert lines == [framed(body) for body in bodies]
        return [body.split(",") for body in bodies]

    def reports(self, verb: str) -> list[list[str]]:
        return [line[2:] for line in self.lines() if line[2] == verb]

    def ask(self, *words: object) -> list[str]:
        """The words of the answer behind its verb; reports that were waiting are thrown away."""
        self.raw()
        self.number += 1
        self.board.receive(framed(",".join(["C", str(self.number), *map(str, words)])))
        return self.lines()[-1][3:]

    def count(self) -> int:
        return int(self.ask("VSYNC")[0])

    def armed(self, pulses: int = 3, ahead: int = 1) -> int:
        """Let an armed sequence pass and return the number of its first vertical sync."""
        first = self.count() + ahead
        assert self.ask("ARM", pulses, first, 500, 12_000) == [str(pulses), str(first), "500", "12000"]
        self.fired.clear()
        self.vsync_times_ns.clear()
        self.raw()
        self.bench.blanks(pulses + 3)
        return first

    def times_ns(self) -> list[int]:
        return [time_ns for time_ns, _, _ in self.fired]

    def late_blanks(self) -> list[float]:
        """By how much each pulse came later than a sequence's that begins with the next sync."""
        return [(t - self.vsync_times_ns[0] - 500_000) / BLANK_NS - k for k, t in enumerate(self.times_ns())]

    def frames(self) -> list[int]:
        return [shot.index for _, _, shot in self.fired]


@pytest.fixture
def desk() -> Iterator[Desk]:
    with bench() as made:
        yield Desk(made)


def test_pulses_rise_on_consecutive_syncs_after_the_delay_and_live_ones_belong_to_no_sequence(desk: Desk) -> None:
    first = desk.armed(ahead=2)
    wanted_ns = [t + 500_000 for t in desk.vsync_times_ns[1:4]]
    assert desk.times_ns() == wanted_ns
    assert {(width_ns, shot.count) for _, width_ns, shot in desk.fired} == {(12_000_000, 3)}
    assert desk.frames() == [0, 1, 2]
    pulses = desk.reports("PULSE")
    assert [p[1:3] for p in pulses] == [[str(k), str(first + k)] for k in range(3)]
    board_us = [int(p[3]) for p in pulses]
    # The board's clock is not the world's, but no more than 50 ppm away from it.
    assert board_us[2] - board_us[0] == pytest.approx(2 * BLANK_NS / 1000, abs=4)
    assert board_us[0] == pytest.approx((wanted_ns[0] - START_NS) / 1000, abs=10)
    series = desk.fired[0][2].series
    desk.armed()
    assert desk.fired[-1][2].series != series
    for every in (1, 60):
        desk.ask("LIVE", every, 100, 4000)
        desk.fired.clear()
        desk.bench.blanks(3 * every)
        desk.bench.run_s(0.001)
        assert set(np.diff(desk.times_ns())) == {every * BLANK_NS}
        assert all(shot.count is None for _, _, shot in desk.fired)


def test_each_board_has_its_own_crystal() -> None:
    drifts_ppm = []
    for seed in range(6):
        with bench() as made:
            desk = Desk(made, seed)
            begin_us, begin_ns = int(desk.ask("PING")[0]), made.time.now_ns()
            made.run_s(30.0)
            true_us = (made.time.now_ns() - begin_ns) / 1000
            drifts_ppm.append(((int(desk.ask("PING")[0]) - begin_us) / true_us - 1) * 1e6)
    assert 5 < max(map(abs, drifts_ppm)) <= 50, "a perfect crystal would hide a host that does not follow it"
    assert len({round(d) for d in drifts_ppm}) > 3


@pytest.mark.parametrize(
    ("fault", "frames", "named", "late_blanks"),
    [
        ("intermittent frame=1", [0, 2], [0, 2], [0, 1]),
        ("wrong how=vsync frame=1", [0, 1, 2], [0, 2, 2], [0, 0, 0]),
        ("delayed frame=1 amount=5", [0, 1, 2], [0, 1, 2], [0, 0.3, 0]),
        ("wrong how=glitch frame=1", [0, 1, 2], [0, 1, 2], [0, -0.5, -1]),
    ],
)
def test_a_pulse_is_not_fired_named_wrongly_late_or_on_the_wrong_sync(
    desk: Desk, fault: str, frames: list[int], named: list[int], late_blanks: list[float]
) -> None:
    desk.bench.faults.add(f"board {fault}")
    first = desk.armed()
    assert desk.frames() == frames
    pulses = desk.reports("PULSE")
    assert [int(p[2]) - first for p in pulses] == named, "the board itself believes that all is well"
    assert desk.late_blanks() == pytest.approx(late_blanks, abs=1e-3)
    assert np.diff([int(p[3]) for p in pulses]) == pytest.approx(np.diff(desk.times_ns()) / 1000, abs=3)


def test_an_answer_may_count_a_vertical_sync_too_many(desk: Desk) -> None:
    before = desk.count()
    desk.bench.faults.add("board wrong how=query count=2")
    assert [desk.count() - before for _ in range(3)] == [1, 1, 0]


def test_a_reset_forgets_everything_and_a_board_without_power_is_silent_until_it_returns(desk: Desk) -> None:
    desk.ask("LASER", 1, 1)
    desk.bench.faults.add("board wrong how=reset frame=2")
    desk.armed(pulses=5)
    assert desk.frames() == [0, 1]
    boot = next(line for line in desk.lines() if line[2] == "BOOT")
    assert (boot[1], boot[-1]) == ("0", "WATCHDOG")
    assert desk.board.lasers_on == (False, False)
    assert int(desk.ask("PING")[0]) < 200_000, "the clock starts again"
    assert desk.count() < 8, "so does the counter"
    desk.ask("LASER", 1, 1)
    desk.raw()
    desk.bench.faults.add("board off for_s=2.0")
    assert desk.board.lasers_on == (False, False)
    desk.board.receive(framed("C,1,PING"))
    desk.bench.run_s(1.9)
    assert desk.raw() == b""
    desk.bench.run_s(0.2)
    assert [boot[-1] for boot in desk.reports("BOOT")] == ["POWER"]


def test_noise_between_lines_leaves_the_lines_whole_and_what_nobody_reads_is_lost_whole(desk: Desk) -> None:
    desk.bench.faults.add("board garbage")
    desk.raw()
    desk.board.receive(framed("C,78,STOP"))
    raw = desk.raw()
    assert raw.endswith(framed("A,78,STOP"))
    assert len(raw) > len(framed("A,78,STOP"))
    desk.bench.faults.clear()
    desk.raw()
    for number in range(4000):
        desk.board.receive(framed(f"C,{number},PING"))
    assert desk.board.waiting <= 65_536
    kept = [int(line[1]) for line in desk.lines()]
    assert kept == list(range(len(kept))), "the newest are lost"


def test_pulses_that_jitter_are_dated_as_they_were_fired() -> None:
    with bench() as made:
        desk = Desk(made, clocks=Clocks(board_jitter_us=40.0))
        late_us: list[float] = []
        for _ in range(4):
            desk.armed(pulses=60)
            late_us += [late * BLANK_NS / 1000 for late in desk.late_blanks()]
            dated_us = np.array([int(p[3]) for p in desk.reports("PULSE")])
            # Crystal of the board: 45 ppm at most of the second that this takes.
            assert np.abs(np.diff(dated_us) - np.diff(desk.times_ns()) / 1000).max() < 3.0
        assert np.std(late_us) == pytest.approx(40.0, rel=0.25)
        assert abs(np.mean(late_us)) < 12.0
